"""What this processor can compute in."""

from __future__ import annotations

__all__ = ["bf16_instructions"]

import functools
from pathlib import Path
from typing import Literal

CPUINFO = Path("/proc/cpuinfo")


@functools.cache
def bf16_instructions(cpuinfo: Path = CPUINFO) -> Literal["amx", "avx512", ""]:
    """The instructions for bfloat16 that this processor has, empty for none.

    Without them bfloat16 is emulated, several times slower than float32. Where the system does not
    tell (only Linux does), the answer is none.
    """
    try:
        lines = cpuinfo.read_text().splitlines()
    except OSError:
        return ""
    flags = next((set(line.split()) for line in lines if line.startswith("flags")), set())
    if "amx_bf16" in flags:
        return "amx"
    return "avx512" if "avx512_bf16" in flags else ""
