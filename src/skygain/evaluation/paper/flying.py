"""Fly what the figures need, each setting once, going on with what is there."""

from __future__ import annotations

__all__ = ["Reproduction", "fly"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING

from skygain.evaluation.comparison import Comparison, Watch, compare
from skygain.evaluation.paper.claims import Flown
from skygain.evaluation.paper.request import ReproduceRequest
from skygain.evaluation.paper.settings import FIGURES, SETTINGS, Setting, installed
from skygain.evaluation.request import EvaluateRequest
from skygain.ground.errors import InputError
from skygain.ground.files import file_digest
from skygain.survey.methods import MethodSpec
from skygain.survey.origins import method_files

if TYPE_CHECKING:
    from skygain.datasets.store import ChannelDataset


@dataclass(frozen=True)
class Reproduction:
    """All that was flown."""

    request: ReproduceRequest
    """what was asked for"""
    figures: dict[str, Flown]
    """by name, each with its methods alone"""
    comparisons: dict[str, Comparison]
    """every setting with all its methods"""
    settings: dict[str, Setting]
    """the settings by name"""
    left_out: list[str]
    """what was not flown, and why"""
    data_digest: str
    """of the data set's content"""
    files: dict[str, str]
    """name → digest of everything that methods read"""


def fly(
    request: ReproduceRequest,
    watch_of: Callable[[str], Watch],
    phase: Callable[[str], None],
    progress: Callable[[int, int, str], None],
    note: Callable[[str], None],
) -> Reproduction:
    """Fly the figures that are asked for.

    Args:
        request: which, of what.
        watch_of: of each setting, what sees its rollouts.
        phase: told what is flown next.
        progress: told how far it is.
        note: told what is left out, and why.

    Raises:
        InputError: unreadable data, or rollouts in ``out`` of other data, settings or weights.
    """
    dataset = _opened(request.data)
    settings, left_out = _settings(dataset, request)
    roles = _roles(request, settings, left_out)
    for line in left_out:
        note(line)
    surveys = _surveys(dataset, request, settings["three"])
    needed: dict[str, dict[str, None]] = {}
    for of_figure in roles.values():
        for name, of_setting in of_figure.items():
            needed.setdefault(name, {}).update(dict.fromkeys(of_setting.values()))
    comparisons = {}
    for number, (name, labels) in enumerate(needed.items(), start=1):
        setting = settings[name]
        phase(f"flying {setting.title} (setting {number} of {len(needed)})")
        asked = EvaluateRequest(
            methods=tuple(labels),
            data=request.data,
            split=request.split,
            max_surveys=surveys,
            uavs=setting.uavs,
            start=setting.start,
            altitude_m=setting.altitude_m,
            steps=request.steps,
            record_every=max(1, request.steps // 8),
            crop=request.crop,
            seed=request.seed,
            workers=request.workers,
            cluster=request.cluster,
            out=request.out / "rollouts" / name,
        )
        comparisons[name] = compare(asked, progress, watch_of(name))
    files: dict[str, str] = {}
    for label in {label for labels in needed.values() for label in labels}:
        files |= method_files(MethodSpec.of_label(label))
    figures = {
        name: Flown({s: comparisons[s] for s in of_figure}, of_figure, settings)
        for name, of_figure in roles.items()
    }
    return Reproduction(
        request,
        figures,
        comparisons,
        settings,
        left_out,
        file_digest(dataset.path),
        dict(sorted(files.items())),
    )


def _opened(data: str) -> ChannelDataset:
    from skygain.datasets.sample import open_sample
    from skygain.datasets.store import ChannelDataset

    return open_sample() if data == "sample" else ChannelDataset.open(data)


def _settings(
    dataset: ChannelDataset, request: ReproduceRequest
) -> tuple[dict[str, Setting], list[str]]:
    """The settings at altitudes that the data has, and what is left out for want of them. Data
    without maps at 10 m is flown at its lowest altitude."""
    known = {float(a) for a in dataset.altitudes_m if dataset.links(request.split, float(a))}
    if not known:
        raise InputError(f"{dataset.path} has no links in split {request.split}; choose another")
    base = 10.0 if 10.0 in known else min(known)
    settings, left_out = {}, []
    for name, setting in SETTINGS.items():
        if name.startswith("altitude"):
            if setting.altitude_m in known and setting.altitude_m != base:
                settings[name] = setting
            elif "altitudes" in request.names:
                left_out.append(f"{setting.title}: the data has no maps at this altitude")
        else:
            settings[name] = replace(setting, altitude_m=base)
    return settings, left_out


def _roles(
    request: ReproduceRequest, settings: dict[str, Setting], left_out: list[str]
) -> dict[str, dict[str, dict[str, str]]]:
    """Figure → setting → role → label of what is flown."""
    found: dict[str, dict[str, dict[str, str]]] = {}
    why: dict[str, None] = {}
    own = {method.label: method.label for method in map(MethodSpec.of_label, request.methods)}
    for mine in own:
        method_files(MethodSpec.of_label(mine))  # raises what cannot be flown, before all the rest
    for figure in request.names:
        found[figure] = {}
        for setting, methods in FIGURES[figure].methods.items():
            if setting not in settings:
                continue
            roles, where = {}, settings[setting].title
            for role, labels in methods.items():
                label, reason = installed(labels)
                if label is not None:
                    roles[role] = label
                if reason:
                    first = labels[0].partition(" / ")[0]
                    fate = (
                        f"{label.partition(' / ')[0]} is flown in place of {first}"
                        if label
                        else f"{first} is not flown"
                    )
                    why[f"{fate}, {where}: {reason}"] = None
            if "random" in methods:  # a figure that compares methods
                roles |= own
            if roles:
                found[figure][setting] = roles
    left_out.extend(why)
    return found


def _surveys(dataset: ChannelDataset, request: ReproduceRequest, setting: Setting) -> int:
    """How many surveys each setting has."""
    there = len(dataset.links(request.split, setting.altitude_m))
    count = min(there, request.max_surveys)
    return max(1, ceil(count / 10)) if request.quick else count
