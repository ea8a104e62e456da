"""Write the surveys of a comparison as files that need NumPy alone."""

from __future__ import annotations

__all__ = ["export_benchmark"]

import hashlib
import tempfile
import zipfile
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import skygain
from skygain.evaluation.benchmark.alone import CASES, TRANSMITTERS, TRUTH
from skygain.evaluation.comparison import request_cases
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write, file_digest, writable_folder

if TYPE_CHECKING:
    from skygain.evaluation.request import EvaluateRequest

_README = "README.md"
_SHIPPED = {"alone.py": "skygain_benchmark.py", "example.txt": "example.py"}


def export_benchmark(request: EvaluateRequest, out: Path, *, overwrite: bool = False) -> str:
    """Write the surveys that ``request`` would fly to the folder ``out``, or to one file if it ends
    in ``.zip``; returns what was written, in words.

    Raises:
        InputError: unreadable data, no such surveys, or ``out`` holds something already.
    """
    packed = out.suffix == ".zip"
    names = (CASES, TRANSMITTERS, TRUTH, _README, *_SHIPPED.values())
    held = [out] if packed else [out / name for name in names]
    for path in held:
        if path.exists() and not overwrite:
            raise InputError(f"{path} exists; give another `out`, or `overwrite=True`")
    written = _files(request)
    if packed:
        with atomic_write(out) as tmp, zipfile.ZipFile(tmp, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in written.items():
                # the same surveys give the same bytes
                archive.writestr(zipfile.ZipInfo(f"{out.stem}/{name}"), content)
    else:
        folder = writable_folder(out)
        for name, content in written.items():
            with atomic_write(folder / name) as tmp:
                tmp.write_bytes(content)
    size = sum(map(len, written.values()))
    told = written[_README].decode().splitlines()
    return f"wrote {out}, {size / 1e6:.1f} MB: {told[2].partition('.')[0]}; see README.md in it"


def _files(request: EvaluateRequest) -> dict[str, bytes]:
    """Name to content."""
    dataset, cases = request_cases(request)
    scenarios = [case.scenario() for case in cases]
    quarter = max(1, request.steps // 4)
    record = sorted({quarter, min(2 * quarter, request.steps), request.steps})
    known: dict[str, Any] = {
        "height_m": np.stack([s.city.height_m for s in scenarios]).astype(np.float32),
        "free": np.stack([s.flyable for s in scenarios]),
        "starts": np.stack([case.start_cells for case in cases]).astype(np.int16),
        "city": np.array([case.city_index for case in cases]),
        "steps": request.steps,
        "record_steps": np.array(record),
        "altitude_m": request.altitude_m,
        "spacing_m": scenarios[0].grid.spacing_m,
        "frequency_hz": scenarios[0].frequency_hz,
        "noise_std_db": request.noise_db,
    }
    hidden = {
        "gain_db": np.stack([case.truth_db for case in cases]),
        "noise_seed": np.array([case.seed for case in cases]),
    }
    told = {"transmitter_m": np.array([s.transmitter_m for s in scenarios])}
    digest = hashlib.sha256()
    for name, value in sorted((known | hidden).items()):
        digest.update(name.encode() + np.ascontiguousarray(value).tobytes())
    id_ = digest.hexdigest()[:12]
    written = {
        CASES: _packed(known | {"id": id_}),
        TRANSMITTERS: _packed(told),
        TRUTH: _packed(hidden | {"id": id_}),
    }
    here = files("skygain.evaluation.benchmark")
    written |= {name: (here / source).read_bytes() for source, name in _SHIPPED.items()}
    rows, cols = cases[0].shape
    noise = f", with Gaussian noise of {request.noise_db:g} dB" if request.noise_db else ""
    text = (
        (here / "readme.md")
        .read_text(encoding="utf-8")
        .format(
            id=id_,
            surveys=len(cases),
            cities=len(np.unique(known["city"])),
            uavs=request.uavs,
            steps=request.steps,
            altitude_m=request.altitude_m,
            noise=noise,
            record=", ".join(map(str, record)),
            record_count=len(record),
            spacing_m=known["spacing_m"],
            last=len(cases) - 1,
            rows=rows,
            cols=cols,
            version=skygain.__version__,
            data=Path(request.data).name,
            data_digest=file_digest(dataset.path),
            split=request.split,
            start=request.start,
            seed=request.seed,
            evaluate=_command(request),
        )
    )
    return written | {_README: text.encode()}


def _packed(arrays: dict[str, Any]) -> bytes:
    with tempfile.TemporaryFile() as file:
        np.savez_compressed(file, **arrays)
        file.seek(0)
        return file.read()


def _command(request: EvaluateRequest) -> str:
    """How Skygain flies the same surveys."""
    like = type(request)()
    words = ["skygain evaluate", f"--data {Path(request.data).name}"]
    for name in ("split", "uavs", "steps", "start", "altitude_m", "noise_db", "seed", "crop"):
        value = getattr(request, name)
        if value != getattr(like, name):
            words.append(f"--{name.removesuffix('_m').replace('_', '-')} {value}")
    if request.max_surveys is not None:
        words.append(f"--max-surveys {request.max_surveys}")
    words.append(f"--record-every {max(1, request.steps // 4)}")
    return " ".join([*words, "--methods 'operator / lookahead, kriging / random-waypoint'"])
