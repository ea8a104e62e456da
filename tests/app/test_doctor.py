from __future__ import annotations

import importlib.metadata

import pytest

from skygain.app import doctor
from skygain.app.doctor import Check, diagnose, render
from skygain.app.requests import DoctorRequest
from skygain.ground.errors import install_command


def test_what_is_here_is_ok_and_named_with_its_release() -> None:
    checks = {check.name: check for check in diagnose(trace=False)}
    assert checks["Python"].state == "ok"
    assert checks["core packages"].state == "ok"
    assert f"numpy {importlib.metadata.version('numpy')}" in checks["core packages"].detail
    assert {"extra raytrace", "extra geo", "extra dev", "networks", "LLVM", "Sionna RT"} <= set(
        checks
    )


def test_everything_missing_has_a_remedy_and_nothing_crashes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", absent)
    monkeypatch.setattr(importlib.metadata, "files", absent)
    monkeypatch.setattr("skygain.ground.llvm._SYSTEM_FOLDERS", ())
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    checks = {check.name: check for check in diagnose()}
    assert checks["core packages"].state == "broken"
    for name in ("core packages", "extra raytrace", "extra geo", "LLVM"):
        assert "pip install" in checks[name].remedy
    assert checks["extra raytrace"].state == "missing"


def test_without_the_ray_tracer_doctor_is_healthy_and_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = importlib.metadata.version

    def version(name: str) -> str:
        if name == "sionna-rt":
            raise importlib.metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(importlib.metadata, "version", version)
    monkeypatch.setattr(doctor, "EXTRAS", {"raytrace": ("sionna-rt",)})
    monkeypatch.setattr("skygain.propagation.sionna.require", _not_installed)
    text = doctor.run_doctor(DoctorRequest())
    assert install_command("raytrace") in text
    assert "two-box scene" not in text


def _not_installed(module: str, extra: str) -> None:
    from skygain.ground.errors import MissingExtraError

    raise MissingExtraError(f"no {module}; pip install 'skygain[{extra}]'")


def test_a_child_that_dies_is_reported_not_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_CHILD", "import os; os.abort()")
    (check,) = doctor._traced()
    assert check.state == "broken"
    assert check.remedy


def test_the_two_box_scene_is_traced_and_agrees_with_theory() -> None:
    from skygain.ground.llvm import find_llvm

    if (
        doctor._version("sionna-rt") is None
        or doctor._version("shapely") is None
        or find_llvm() is None
    ):
        pytest.skip("Sionna RT, shapely or LLVM is missing: pip install 'skygain[raytrace]'")
    scene, diffraction = doctor._traced()
    assert (scene.state, diffraction.state) == ("ok", "ok"), render([scene, diffraction])


def test_the_text_has_a_line_per_check_and_its_remedy_below() -> None:
    text = render([Check("a", "ok", "fine"), Check("bcd", "missing", "not here", "get it")])
    assert text.splitlines()[0].startswith("[ok] a")
    assert "-> get it" in text.splitlines()[2]
