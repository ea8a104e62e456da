"""Where the LLVM library is that the ray tracer compiles with.

Sionna RT runs on Dr.Jit, which compiles with libLLVM when there is no graphics card. Python wheels
do not link to it, so it has to be found at run time. Dr.Jit accepts release 15, but there the ray
tracer ends the process with "Cannot select: fmaximum" on processors with AVX-512; 17 is the first
release that knows the instruction, 19 and 23 are tested. Dr.Jit reads the location when it is
imported, so `activate` must come before. Skygain looks in a fixed order and stops at the first that
exists:

1. the file named by the environment variable ``DRJIT_LIBLLVM_PATH``: the user knows best;
2. the wheel ``karellen-llvm-core`` (extra ``raytrace``): the same LLVM release on every machine, so
   the same rounding;
3. the operating system's libLLVM with the highest release (Debian: ``apt-get install libllvm19``).

The wheel's libLLVM needs its own libc++, which `activate` loads first. It is loaded with local
symbols: with global ones libc++abi takes over the C++ exceptions of every library loaded later, and
importing Matplotlib then ends the process.
"""

from __future__ import annotations

__all__ = ["LLVM", "OLDEST_LLVM", "activate", "check_loaded", "find_llvm", "llvm_remedy"]

import ctypes
import importlib.metadata
import os
import re
from dataclasses import dataclass
from pathlib import Path

from skygain.ground.errors import InputError, install_command

OLDEST_LLVM = 17
"""first LLVM release that can compile the ray tracer's kernels"""

_WHEEL = "karellen-llvm-core"
_VARIABLE = "DRJIT_LIBLLVM_PATH"
_SYSTEM_FOLDERS = (
    "/usr/lib",
    "/usr/lib64",
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
)


def llvm_remedy() -> str:
    """How to get a libLLVM, for messages."""
    return (
        f"{install_command('raytrace')} (brings the wheel karellen-llvm-core), or on Debian: "
        "apt-get install libllvm19"
    )


@dataclass(frozen=True)
class LLVM:
    """A libLLVM that can be given to Dr.Jit."""

    path: Path
    """the shared library"""
    source: str
    """``"environment"``, ``"wheel"`` or ``"system"``"""
    needs: tuple[Path, ...] = ()
    """libraries to be loaded before it, in this order"""

    @property
    def release(self) -> int | None:
        """Major release read off the file name, ``None`` if the name does not tell."""
        return _release(self.path.resolve().name) or _release(self.path.name)


def find_llvm() -> LLVM | None:
    """The libLLVM that ray tracing will use, or ``None`` when there is none (then Dr.Jit's own
    search has the last word)."""
    named = os.environ.get(_VARIABLE)
    if named:
        return LLVM(Path(named), "environment")
    return _in_wheel() or _in_system()


def activate() -> LLVM | None:
    """Make the found libLLVM known to Dr.Jit; harmless when repeated, and without effect once
    Dr.Jit is imported.

    Raises:
        InputError: ``DRJIT_LIBLLVM_PATH`` names a file that does not exist, or the wheel's library
            cannot be loaded.
    """
    found = find_llvm()
    if found is None:
        return None
    if found.source == "environment" and not found.path.is_file():
        raise InputError(
            f"{_VARIABLE} names {found.path}, which is not a file; correct or unset it, or "
            f"{llvm_remedy()}"
        )
    try:
        for library in found.needs:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_LOCAL)
    except OSError as error:
        raise InputError(
            f"the LLVM wheel cannot be loaded ({error}); on Debian: apt-get install libatomic1 "
            "libllvm19"
        ) from error
    os.environ[_VARIABLE] = str(found.path)
    return found


def check_loaded(release: tuple[int, ...]) -> None:
    """Raise `InputError` if the LLVM that Dr.Jit has loaded is too old (a kernel it cannot compile
    would end the process)."""
    if release[0] < OLDEST_LLVM:
        raise InputError(
            f"ray tracing needs LLVM {OLDEST_LLVM} or newer, and Dr.Jit has loaded "
            f"{'.'.join(map(str, release))}; {llvm_remedy()} "
            "(if that is done already: import skygain's ray tracer before mitsuba or drjit)"
        )


def _in_wheel() -> LLVM | None:
    try:
        files = importlib.metadata.files(_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    # The records are relative to site-packages; the libraries lie in the environment's lib folder.
    paths = [
        Path(str(f.locate())).resolve()
        for f in files
        if f.name.startswith(("libLLVM", "libc++", "libunwind"))
    ]
    libraries = [
        p for p in paths if re.fullmatch(r"libLLVM\.so\.\d+(\.\d+)*", p.name) and p.is_file()
    ]
    if not libraries:
        return None
    needs = []
    for name in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):
        needs += sorted({p for p in paths if p.name.startswith(name) and p.is_file()})[:1]
    return LLVM(max(libraries, key=lambda p: _release(p.name) or 0), "wheel", tuple(needs))


def _in_system() -> LLVM | None:
    found: list[tuple[int, Path]] = []
    for folder in _SYSTEM_FOLDERS:
        root, *rest = folder.split("*", 1)
        base = Path(root) if not rest else Path(root).parent
        folders = [base] if not rest else base.glob(folder[len(str(base)) + 1 :])
        for place in folders:
            for path in (*place.glob("libLLVM*.so*"), *place.glob("libLLVM*.dylib")):
                release = _release(path.name)
                if release is not None and release >= OLDEST_LLVM and path.is_file():
                    found.append((release, path))
    if not found:
        return None
    return LLVM(max(found, key=lambda item: (item[0], -len(item[1].name)))[1], "system")


def _release(name: str) -> int | None:
    match = re.search(r"libLLVM[-.](?:so\.)?(\d+)", name)
    return int(match.group(1)) if match else None
