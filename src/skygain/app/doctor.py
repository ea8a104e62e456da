"""What is installed, what is missing, and the command that brings it: the text of `skygain doctor`.

Every check ends in a line with a remedy where one is needed. Ray tracing is proved, not assumed: a
small scene is traced in a process of its own, because a wrong LLVM ends the process it is loaded
into.
"""

from __future__ import annotations

__all__ = ["Check", "diagnose", "render", "run_doctor"]

import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass

from skygain.app.progress import SILENT, Progress
from skygain.app.requests import DoctorRequest
from skygain.ground.errors import install_command

OLDEST_PYTHON = (3, 11)

CORE = (
    "numpy",
    "scipy",
    "numba",
    "xarray",
    "zarr",
    "h5netcdf",
    "matplotlib",
    "click",
    "rich",
    "safetensors",
    "onnxruntime",
)
"""packages without which Skygain does not work"""

EXTRAS = {
    "train": ("torch", "onnx"),
    "raytrace": ("sionna-rt", "shapely"),
    "geo": ("rasterio", "pyproj", "shapely", "pyogrio"),
    "rl": ("pettingzoo", "gymnasium"),
    "dev": ("pytest", "hypothesis", "ruff", "mypy", "scikit-learn", "pycraf"),
}
"""optional features and their packages"""

TRACE_TIMEOUT_S = 300.0

_CHILD = """
import dataclasses, json
from skygain.propagation import selfcheck
boxes = dataclasses.asdict(selfcheck.trace_two_boxes())
traced, expected = selfcheck.reflection_boundary_db()
import drjit.detail, mitsuba
variant = mitsuba.variant()
llvm = ".".join(map(str, drjit.detail.llvm_version())) if variant.startswith("llvm") else ""
found = dict(boxes=boxes, traced_db=traced, expected_db=expected, variant=variant, llvm=llvm)
print(json.dumps(found))
"""


@dataclass(frozen=True)
class Check:
    """One thing looked at."""

    name: str
    """what was looked at"""
    state: str
    """``"ok"``, ``"missing"`` (optional and absent), ``"broken"`` (needed and absent, or present
    and wrong)"""
    detail: str
    """what was found"""
    remedy: str = ""
    """what to do about it, empty when nothing is needed"""


def run_doctor(request: DoctorRequest, progress: Progress = SILENT) -> str:
    """The text for the terminal; ends the process with code 1 where something is broken (a missing
    optional feature is not broken)."""
    checks = diagnose()
    if any(check.state == "broken" for check in checks):
        print(render(checks))
        raise SystemExit(1)
    return render(checks)


def diagnose(*, trace: bool = True) -> list[Check]:
    """Look at everything; with ``trace`` also trace the two-box scene (some seconds)."""
    core = _core()
    checks = [_python(), core, *(_extra(name) for name in EXTRAS), _compute(), _llvm()]
    if core.state == "ok":  # the ray tracer's adapter needs it
        checks.append(_sionna())
        if trace and checks[-1].state == "ok":
            checks += _traced()
    return checks


def render(checks: list[Check]) -> str:
    """A line per check, and its remedy under it."""
    mark = {"ok": "ok", "missing": "--", "broken": "!!"}
    width = max(len(check.name) for check in checks)
    lines = []
    for check in checks:
        lines.append(f"[{mark[check.state]}] {check.name:<{width}}  {check.detail}")
        if check.remedy:
            lines.append(f"     {'':<{width}}  -> {check.remedy}")
    return "\n".join(lines)


def _python() -> Check:
    wanted = ".".join(map(str, OLDEST_PYTHON))
    detail = (
        f"{platform.python_version()} on {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} "
        "cores"
    )
    if sys.version_info < OLDEST_PYTHON:
        return Check("Python", "broken", detail, f"install Python {wanted} or newer")
    return Check("Python", "ok", detail)


def _core() -> Check:
    found = {name: _version(name) for name in CORE}
    missing = [name for name, version in found.items() if version is None]
    detail = ", ".join(f"{name} {version}" for name, version in found.items() if version)
    if missing:
        return Check(
            "core packages",
            "broken",
            f"{detail}; missing: {', '.join(missing)}",
            install_command(),
        )
    return Check("core packages", "ok", detail)


def _extra(extra: str) -> Check:
    found = {name: _version(name) for name in EXTRAS[extra]}
    missing = [name for name, version in found.items() if version is None]
    detail = (
        ", ".join(f"{name} {version}" for name, version in found.items() if version)
        or "not installed"
    )
    if missing:
        if len(missing) < len(found):
            detail += f"; missing: {', '.join(missing)}"
        return Check(f"extra {extra}", "missing", detail, install_command(extra))
    return Check(f"extra {extra}", "ok", detail)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _compute() -> Check:
    """Where neural networks would run; PyTorch only trains them."""
    from skygain.networks.runtime import n_threads

    return Check(
        "networks",
        "ok",
        f"ONNX Runtime {_version('onnxruntime') or 'absent'}, {n_threads()} threads, PyTorch "
        f"{_version('torch') or 'absent'}; processor {_processor()}",
    )


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            text = file.read()
    except OSError:
        return platform.processor() or platform.machine()
    names = [
        line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")
    ]
    from skygain.networks.processor import bf16_instructions

    flags = next(
        (
            set(line.split(":", 1)[1].split())
            for line in text.splitlines()
            if line.startswith("flags")
        ),
        set(),
    )
    vector = next(
        (label for flag, label in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags),
        "no AVX2",
    )
    bf16 = "bfloat16 in hardware" if bf16_instructions() else "no bfloat16"
    return f"{names[0] if names else platform.machine()} ({vector}, {bf16})"


def _llvm() -> Check:
    from skygain.ground.llvm import OLDEST_LLVM, find_llvm, llvm_remedy

    found = find_llvm()
    if found is None:
        return Check(
            "LLVM", "missing", "none found; needed to trace rays on a processor", llvm_remedy()
        )
    detail = f"{found.path} (from the {found.source})"
    if not found.path.is_file():
        return Check(
            "LLVM",
            "broken",
            f"{detail} is not a file",
            f"unset DRJIT_LIBLLVM_PATH, or {llvm_remedy()}",
        )
    if found.release is not None and found.release < OLDEST_LLVM:
        return Check(
            "LLVM",
            "broken",
            f"{detail} is release {found.release}, older than {OLDEST_LLVM}",
            llvm_remedy(),
        )
    return Check("LLVM", "ok", detail)


def _sionna() -> Check:
    from skygain.ground.errors import InputError, MissingExtraError
    from skygain.propagation.sionna import check_release

    try:
        release = check_release()
    except MissingExtraError:
        return Check(
            "Sionna RT",
            "missing",
            "not installed; needed to trace rays",
            install_command("raytrace"),
        )
    except InputError as error:
        return Check("Sionna RT", "broken", str(error), "pip install --upgrade 'sionna-rt>=2.1.0'")
    return Check("Sionna RT", "ok", f"{release}, with the corrected diffraction coefficients")


def _traced() -> list[Check]:
    """Trace in a child process and judge the numbers."""
    remedy = f"install the tested releases: {install_command('raytrace')} -c constraints.txt"
    try:
        child = subprocess.run(
            [sys.executable, "-c", _CHILD],
            capture_output=True,
            text=True,
            timeout=TRACE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return [
            Check("two-box scene", "broken", f"not traced within {TRACE_TIMEOUT_S:g} s", remedy)
        ]
    if child.returncode != 0:
        last = (child.stderr.strip().splitlines() or ["no message"])[-1]
        return [
            Check(
                "two-box scene",
                "broken",
                f"tracing failed with exit code {child.returncode}: {last[:300]}",
                remedy,
            )
        ]
    found = json.loads(child.stdout.strip().splitlines()[-1])
    boxes = found["boxes"]
    sane = (
        boxes["line_of_sight_error_db"] < 0.5
        and boxes["shadow_db"] < -6.0
        and 0.5 < boxes["reached"] <= 1.0
    )
    detail = (
        f"traced in {boxes['seconds']:.1f} s on "
        f"{found['variant']}{' with LLVM ' + found['llvm'] if found['llvm'] else ''}; "
        f"in sight within {boxes['line_of_sight_error_db']:.2f} dB of Friis, out of sight "
        f"{boxes['shadow_db']:.1f} dB against it"
        f"{'' if sane else ' (not what physics says)'}"
    )
    traced, expected = found["traced_db"], found["expected_db"]
    right = abs(traced - expected) < 2.0
    boundary = (
        f"on a reflection's boundary {traced:.1f} dB against free space, "
        f"theory says {expected:.1f} dB"
    )
    return [
        Check("two-box scene", "ok" if sane else "broken", detail, "" if sane else remedy),
        Check("diffraction", "ok" if right else "broken", boundary, "" if right else remedy),
    ]
