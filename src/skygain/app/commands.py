"""The commands that need nothing of their own: training, exports."""

from __future__ import annotations

__all__ = ["run_export", "run_kriging", "run_policy", "run_predictor"]

import sys
from typing import Any

from skygain.app.progress import Progress
from skygain.app.requests import (
    ExportOnnxRequest,
    TrainKrigingRequest,
    TrainPolicyRequest,
    TrainPredictorRequest,
    TrainRequest,
)
from skygain.app.signals import stopping
from skygain.ground.errors import require

STOPPING = "stopping: what is under way is finished and saved; the same command goes on"


def run_kriging(request: TrainKrigingRequest, progress: Progress) -> str:
    """The fitted parameters."""
    from skygain.training.kriging import train_kriging

    return str(train_kriging(request.data, request.out, report=_say))


def run_policy(request: TrainPolicyRequest, progress: Progress) -> str:
    """Train a policy; returns its scores."""
    from skygain.training import train_policy
    from skygain.training.run import stop_runs

    with stopping(stop_runs, STOPPING):
        result = train_policy(
            request.recipe, request.data, request.out, report=_say, **_changes(request)
        )
    return f"{result.step} steps, {result.seconds / 60:.0f} minutes; scores {result.scores}"


def run_predictor(request: TrainPredictorRequest, progress: Progress) -> str:
    """Train a network; returns its scores."""
    from skygain.training import train_predictor
    from skygain.training.run import stop_runs

    changes = _changes(request)
    for name in ("finish", "keep"):
        if getattr(request, name) is not None:
            changes[name] = getattr(request, name)
    with stopping(stop_runs, STOPPING):
        result = train_predictor(request.recipe, request.data, request.out, report=_say, **changes)
    return (
        f"{result.step} steps, {result.samples} samples, {result.seconds / 60:.0f} minutes; scores "
        f"{result.scores}"
    )


def run_export(request: ExportOnnxRequest, progress: Progress) -> str:
    """Export a network; returns where to."""
    require("onnx", "train")
    from skygain.networks.graphs import export_onnx

    export_onnx(request.network, request.out, weights=request.weights)
    return f"wrote {request.out}"


def _changes(request: TrainRequest) -> dict[str, Any]:
    """What is asked for beside the recipe."""
    changes = {
        "max_seconds": None if request.minutes is None else 60 * request.minutes,
        "start_from": request.start_from,
        "cluster": request.cluster,
    }
    return {name: value for name, value in changes.items() if value is not None}


def _say(record: dict[str, object]) -> None:
    """A line of a run's log, for people."""
    print("  ".join(f"{key} {value}" for key, value in record.items()), file=sys.stderr, flush=True)
