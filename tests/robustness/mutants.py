"""Files of every format, damaged in every way, read in a process of their own.

Run as ``python -m tests.robustness.mutants SOURCES KIND SEED COUNT``: writes a line for each mutant
that ends in anything but a sound city or recording, or one line; the seed finds it again. A child
reads some hundreds; one that dies costs the mutant that it was reading.
"""

from __future__ import annotations

import mmap
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

ODD = (b"", b"NaN", b"null", b"-1", b"1e400", b"1e30", b"0", b'"', b"{}", b"[]", b"<", b"180.5")
ODD += (b"\x00", b"99999999999", b"-0.0", b"2147483648", b"\xff\xfe", b"1;2", b"0x10")
"""what a number of a text file is replaced by"""

MOST_BYTES, MOST_SECONDS, AT_ONCE = 1_000_000_000, 60, 500
"""resident memory and time that a mutant may take, and how many a child reads"""


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content with bytes changed, cut off, cut out, doubled, or its numbers replaced."""
    changed = bytearray(content)
    kind = rng.integers(6)
    if kind == 0:
        for i in rng.integers(len(changed), size=rng.integers(1, 9)):
            changed[i] = rng.integers(256)
    elif kind == 1:
        del changed[rng.integers(len(changed)) :]
    elif kind in (2, 3):
        start = int(rng.integers(len(changed)))
        piece = changed[start : start + int(rng.integers(1, 200))]
        changed[start : start + (len(piece) if kind == 2 else 0)] = b"" if kind == 2 else piece
    elif kind == 4:
        lines = content.split(b"\n")
        head = lines[:20]
        rng.shuffle(head)
        lines[:20] = head
        lines.pop(int(rng.integers(len(lines))))
        changed = bytearray(b"\n".join(lines))
    else:
        numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?", content))
        for match in reversed([m for m in numbers if rng.random() < 3 / len(numbers)]):
            changed[match.start() : match.end()] = ODD[rng.integers(len(ODD))]
    return bytes(changed)


def complaint_of_city(path: Path) -> str:
    """What is wrong with how a city was read; empty when it is sound or refused in one line."""
    from skygain.cities import read_city
    from skygain.ground.errors import InputError

    try:
        reading = read_city(path, spacing_m=8.0, crs=_crs(path))
    except InputError as error:
        return _complaint(error)
    city = reading.city
    if not (np.isfinite(city.height_m).all() and np.isfinite(city.ground_m).all()):
        return "heights that are no numbers"
    if city.height_m.min() < 0:
        return "heights below zero"
    if not city.height_m.any() and not reading.remarks:
        return "a city of nothing without a word"
    return ""


def _crs(path: Path) -> str | None:
    return "EPSG:32633" if path.suffix == ".shp" else None


def complaint_of_log(path: Path) -> str:
    """The same of a recording."""
    from skygain.ground.errors import InputError
    from skygain.instruments import grid_for, on_grid, read_recording

    level = {"level": "RADIO_STATUS.rssi"} if path.suffix == ".tlog" else None
    level = {"level": "MODM.RSRP"} if path.suffix == ".bin" else level
    try:
        recording = read_recording(path, columns=level)
        on_grid(recording, grid_for(recording, 50.0))
    except InputError as error:
        return _complaint(error)
    place = recording.xy_m if recording.latlon is None else recording.latlon
    if not len(recording):
        return "a recording of nothing"
    if not (np.isfinite(recording.level_db).all() and np.isfinite(place).all()):
        return "levels or places that are no numbers"
    return ""


def _complaint(error: Exception) -> str:
    text = str(error)
    if "\n" in text or not 10 < len(text) < 900:
        return f"no single line: {text[:200]!r}"
    return ""


def _late(number: int, frame: object) -> None:
    raise TimeoutError(f"more than {MOST_SECONDS} s")


def main(folder: str, kind: str, seed: str, count: str) -> None:
    warnings.simplefilter("ignore")
    judge = {"city": complaint_of_city, "log": complaint_of_log}[kind]
    sources = sorted(p for p in Path(folder).iterdir() if p.suffix not in (".shx", ".dbf", ".cpg"))
    for source in sources:  # what is imported once takes longer than any mutant
        if found := judge(source):
            print(f"bad {source.name}, which is sound: {found}")
    at, end = int(seed), int(seed) + int(count)
    reached = np.frombuffer(mmap.mmap(-1, 8), dtype=np.int64)
    while at < end:
        last = min(at + AT_ONCE, end)
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            code = 1
            try:
                read(judge, sources, range(at, last), reached)
                code = 0
            finally:
                os._exit(code)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        at = last
        if status:
            at = int(reached[0]) + 1
            print(f"bad {at - 1} {sources[(at - 1) % len(sources)].name}: ended with {status}")
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6
    print(f"done: {count} damaged files of {len(sources)} kinds, at most {most:.0f} MB")


def read(
    judge: Callable[[Path], str], sources: list[Path], numbers: range, reached: np.ndarray
) -> None:
    """Judge these mutants, in a process that may take no more than it should; their complaints go
    to the output, and what the libraries print goes nowhere."""
    told = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    pages, resident = map(int, Path("/proc/self/statm").read_text().split()[:2])
    room = MOST_BYTES + (pages - resident) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
    signal.signal(signal.SIGALRM, _late)
    with tempfile.TemporaryDirectory() as place:
        for number in numbers:
            reached[0] = number
            source = sources[number % len(sources)]
            found = judged(judge, source, Path(place) / str(number), number)
            if found:
                print(f"bad {number} {source.name}: {' '.join(found.split())}", file=told)
                told.flush()


def judged(judge: Callable[[Path], str], source: Path, folder: Path, number: int) -> str:
    """What is wrong with how the mutant of that number was read."""
    folder.mkdir()
    path = folder / f"x{''.join(source.suffixes)}"
    for beside in (".shx", ".dbf"):
        if source.with_suffix(beside).exists():
            shutil.copyfile(source.with_suffix(beside), path.with_suffix(beside))
    path.write_bytes(mutated(source.read_bytes(), np.random.default_rng(number)))
    signal.alarm(MOST_SECONDS)
    try:
        return judge(path)
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.alarm(0)
        shutil.rmtree(folder)


if __name__ == "__main__":
    main(*sys.argv[1:])
