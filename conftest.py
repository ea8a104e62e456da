"""Without PyTorch (extra `train`) what needs it is not collected; the rest is the core's suite."""

from __future__ import annotations

import importlib.util

WITHOUT_TORCH = importlib.util.find_spec("torch") is None

collect_ignore_glob = (
    [
        "src/skygain/training/*",
        "src/skygain/networks/torch_runtime.py",
        "src/skygain/networks/operator/network.py",
        "src/skygain/networks/operator/locator.py",
        "src/skygain/networks/policies/network.py",
        "src/skygain/networks/unets/*",
        "tests/training/*",
        "tests/networks/*",
        "tests/predictors/networks/*",
        "tests/predictors/kriging/test_residual.py",
        "tests/robustness/test_trainings.py",
        "tests/benchmarks/*",
        "tests/docs/*",
    ]
    if WITHOUT_TORCH
    else []
)


def pytest_report_header() -> str | None:
    """Say what is left out."""
    return (
        "PyTorch is not installed: training and its tests are left out" if WITHOUT_TORCH else None
    )
