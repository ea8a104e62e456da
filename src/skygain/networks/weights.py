"""Weight files: named arrays and the card that says where they come from.

A weight file is safetensors; the card stands in its header and, readable, beside it. Weights are
looked for by name in the package, in the package of the paper's weights, then in `runs_folder`,
where training leaves them; a file of one's own is given by its path. NumPy is enough to read them.
"""

from __future__ import annotations

__all__ = [
    "POLICIES",
    "TRAINABLE",
    "Weights",
    "export_weights",
    "find_weights",
    "graph_file",
    "packed",
    "read_card",
    "read_weights",
    "runs_folder",
    "trained_here",
    "weight_file",
    "write_weights",
]

import importlib.util
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError, did_you_mean, install_command
from skygain.ground.files import atomic_write
from skygain.networks.quantised import dequantised, multipliable, quantised

LARGE = 1_000_000
"""weights beyond which a matrix is worth quantising"""
PACKAGE_WEIGHTS = Path(__file__).parents[1] / "data" / "weights"
EXTRA_WEIGHTS = {"paper-unet": "skygain-paper-weights"}
"""weights that a distribution of their own brings"""
TRAINABLE = (
    "operator",
    "operator-no-profile",
    "path-model",
    "locator",
    "judge",
    "unet",
    "paper-unet",
    "paper-unet-mapblind",
    "paper-unet-5",
    "paper-unet-20m",
    "paper-unet-30m",
)
"""names of the recipes of `skygain train predictor`"""
POLICIES = ("paper-dqn", "dqn", "dqn-rewards-only", "dqn-thin-plate", "imitation")
"""names of the recipes of `skygain train policy`"""
AVERAGE = "average."
"""before the names of a run's averaged weights in its checkpoint"""
COUNTER = "num_batches_tracked"
"""ends the name of what PyTorch counts while it trains"""


@dataclass(frozen=True, eq=False)
class Weights:
    """What a weight file holds."""

    path: Path
    """the file"""
    arrays: dict[str, NDArray]
    """by name, in float32"""
    card: dict[str, Any]
    """data, recipe, scores"""
    codes: dict[str, NDArray] = field(default_factory=dict)
    """of matrices that the file holds in 4 bits, what multiplies without unpacking them, see
    `skygain.networks.quantised.multipliable`"""

    @property
    def handed(self) -> dict[str, NDArray]:
        """What ONNX Runtime is given by name: the arrays, matrices of 4 bits as `codes`."""
        plain = {k: v for k, v in self.arrays.items() if f"{k}.q4" not in self.codes}
        return plain | self.codes

    @property
    def task(self) -> dict[str, Any]:
        """Settings of what was learned, from the card's recipe; empty where the card has none."""
        return self.card.get("recipe", {}).get("task", {})


def runs_folder() -> Path:
    """Where runs go unless told otherwise: ``$SKYGAIN_CACHE/runs``, by default
    ``~/.cache/skygain/runs``."""
    cache = os.environ.get("SKYGAIN_CACHE") or os.path.expanduser("~/.cache/skygain")
    return Path(cache) / "runs"


def find_weights(name: str) -> Path:
    """The weight file called ``name``.

    Raises:
        InputError: there is none; the message says which command brings or makes it.
    """
    folders = [PACKAGE_WEIGHTS, runs_folder() / name]
    distribution = EXTRA_WEIGHTS.get(name)
    if distribution and (spec := importlib.util.find_spec(distribution.replace("-", "_"))):
        folders[1:1] = map(Path, spec.submodule_search_locations or ())
    for folder in folders:
        if (path := folder / f"{name}.safetensors").exists():
            return path
    if distribution:
        raise InputError(
            f"the weights {name!r} come in a package of their own, which is not installed; "
            f"bring them with: {install_command('paper')}"
        )
    if name not in TRAINABLE:
        raise InputError(
            f"there are no weights {name!r} (a file ends in .safetensors); "
            f"{did_you_mean(name, sorted({*TRAINABLE, *trained_here()} - {*POLICIES}))}"
        )
    raise InputError(
        f"the weights {name!r} do not ship with this version and were not trained here; make them "
        "with: "
        f"skygain train predictor --recipe {name} (a data set is needed: skygain dataset --help)"
    )


def trained_here() -> set[str]:
    """Names of the weights that runs have left."""
    return {path.stem for path in runs_folder().glob("*/*.safetensors")} - {"checkpoint"}


def weight_file(name: str | Path) -> Path:
    """The file ``name`` if it ends in ``.safetensors``, else the weights of that name."""
    return Path(name) if str(name).endswith(".safetensors") else find_weights(str(name))


def graph_file(weights: Path) -> Path:
    """Where the graph of a weight file stands, see `skygain.networks.graphs`."""
    return weights.with_suffix(".onnx")


def read_weights(name: str | Path) -> Weights:
    """The weights called ``name`` (or in the file ``name``), quantised ones unpacked. Of a run's
    own checkpoint these are the averaged ones.

    Raises:
        InputError: there are none, or the file is no weight file of ours.
    """
    path = weight_file(name)
    with _opened(path) as (file, card):
        keys = [key for key in file.keys() if not key.endswith(COUNTER)]  # noqa: SIM118 - no dict
        averaged = [key for key in keys if key.startswith(AVERAGE)]
        arrays = {key.removeprefix(AVERAGE): file.get_tensor(key) for key in averaged or keys}
    floats = {key: value.astype(np.float32) for key, value in dequantised(arrays).items()}
    return Weights(path, floats, card, multipliable(arrays))


def read_card(path: Path) -> dict[str, Any]:
    """The card in the header of a weight file.

    Raises:
        InputError: it is no weight file of ours.
    """
    with _opened(path) as (_, card):
        return card


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, dict[str, Any]]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="np") as file:
            card = json.loads((file.metadata() or {})["skygain"])
            if "config" in card:  # a run's own checkpoint
                card["recipe"] = card.pop("config")
            yield file, card
    except (OSError, SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path} is not a weight file of Skygain ({error}); give one written by `skygain train`"
        ) from error


def write_weights(path: Path, arrays: Mapping[str, Any], card: dict[str, Any]) -> None:
    """Write ``arrays`` (of NumPy, or tensors on the processor) with ``card`` in the header, and the
    card as JSON beside them."""
    from safetensors.numpy import save

    found = {key: np.ascontiguousarray(value) for key, value in arrays.items()}
    with atomic_write(path) as tmp:
        # the library's own writing hides what is wrong with a disk
        tmp.write_bytes(save(found, metadata={"skygain": json.dumps(card)}))
    with atomic_write(path.with_suffix(".json")) as tmp:
        tmp.write_text(json.dumps(card, indent=2) + "\n")


def packed(arrays: Mapping[str, Any], bits: int = 0) -> dict[str, NDArray]:
    """``arrays`` in float16; with ``bits`` 4 or 8, matrices of more than a million weights
    quantised."""
    out: dict[str, NDArray] = {}
    for key, value in arrays.items():
        array = np.asarray(value)
        if bits and array.ndim == 2 and array.size > LARGE:
            out |= quantised(key, array, bits)
        else:
            out[key] = array.astype(np.float16)
    return out


def export_weights(checkpoint: Path, path: Path, card: dict[str, Any], bits: int = 0) -> None:
    """Write the averaged weights of a run as a weight file with ``card`` in its header, its scores
    and its recipe added; see `packed` for ``bits``."""
    weights = read_weights(checkpoint)
    meta, recipe = weights.card, _shareable(weights.card["recipe"])
    card = {
        **card,
        "steps": meta["step"],
        "training_seconds": round(meta["seconds"]),
        "scores": meta["scores"],
        "samples": meta["step"] * recipe["batch_size"],
        "recipe": recipe,
    }
    write_weights(path, packed(weights.arrays, bits), card)


def _shareable(config: dict[str, Any]) -> dict[str, Any]:
    """``config`` without the folders of this machine."""
    kept = {key: value for key, value in config.items() if key not in ("data", "out")}
    kept["start_from"] = "/".join(Path(config.get("start_from", "")).parts[-2:])
    return kept
