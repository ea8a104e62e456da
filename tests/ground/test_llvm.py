from __future__ import annotations

from pathlib import Path

import pytest

from skygain.ground import llvm
from skygain.ground.errors import InputError
from skygain.propagation import sionna


def test_the_users_choice_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    chosen = tmp_path / "libLLVM.so.19.1"
    chosen.touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(chosen))
    found = llvm.find_llvm()
    assert found == llvm.LLVM(chosen, "environment")
    assert found.release == 19


def test_a_choice_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    with pytest.raises(InputError, match="/nowhere/libLLVM"):
        llvm.activate()


def test_the_newest_usable_system_library_is_taken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in (
        "libLLVM-14.so.1",
        "libLLVM-15.so.1",
        "libLLVM-19.so",
        "libLLVM.so.19.1",
        "libLLVM.so.22.1",
        "libLLVM.so",
    ):
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "_SYSTEM_FOLDERS", (f"{tmp_path.parent}/*",))
    found = llvm._in_system()
    assert found is not None
    assert (found.path.name, found.source, found.release) == ("libLLVM.so.22.1", "system", 22)
    monkeypatch.setattr(llvm, "_SYSTEM_FOLDERS", (str(tmp_path / "empty"),))
    assert llvm._in_system() is None


def test_an_old_llvm_is_refused_before_it_ends_the_process() -> None:
    with pytest.raises(InputError, match="17"):
        llvm.check_loaded((15, 0, 6))
    llvm.check_loaded((19, 1, 7))


@pytest.mark.parametrize("release", ["1.2.1", "2.0.1"])
def test_a_sionna_with_wrong_diffraction_is_refused(
    monkeypatch: pytest.MonkeyPatch, release: str
) -> None:
    monkeypatch.setattr(sionna.importlib.metadata, "version", lambda name: release)
    with pytest.raises(InputError, match=r"2\.1\.0"):
        sionna.check_release()


@pytest.mark.parametrize("release", ["2.1.0", "2.10.0", "3.0.0"])
def test_later_releases_are_accepted(monkeypatch: pytest.MonkeyPatch, release: str) -> None:
    monkeypatch.setattr(sionna.importlib.metadata, "version", lambda name: release)
    assert sionna.check_release() == release
