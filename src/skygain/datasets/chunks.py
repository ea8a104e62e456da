"""What the chunks of a data set say they unpack to, looked at before any is unpacked.

A chunk of a few kilobytes can unpack to gigabytes. Each has to say its size, and the size has to be
that of its array's chunks.
"""

from __future__ import annotations

__all__ = ["check_chunks", "unpacked_bytes"]

import zipfile
from math import prod
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError

ZSTANDARD = bytes.fromhex("28b52ffd")
"""first bytes of a frame"""
HEADER_BYTES = 18
"""of a frame, at most"""


def check_chunks(path: Path, arrays: dict[str, Any]) -> None:
    """Look at every chunk of the Zarr ``arrays`` in the zip file ``path``.

    Raises:
        InputError: a chunk is packed in another way than ours, or would unpack to another size than
            its array says.
    """
    packed = set()
    for name, array in arrays.items():
        codecs = [type(codec).__name__ for codec in array.metadata.codecs]
        if codecs not in (["BytesCodec"], ["BytesCodec", "ZstdCodec"]):
            raise InputError(
                f"{path}: {name} is packed with {', '.join(codecs)}; only bytes, plain or with "
                "Zstandard, are read; convert it or build the data set anew"
            )
        if len(codecs) == 2:
            packed.add(name)
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            name, _, key = entry.filename.partition("/")
            if name not in packed or key == "zarr.json":
                continue
            with archive.open(entry) as file:
                header = file.read(HEADER_BYTES)
            stated = prod(arrays[name].chunks) * arrays[name].dtype.itemsize
            # what is no frame at all is refused by whoever unpacks it
            if header.startswith(ZSTANDARD) and (size := unpacked_bytes(header)) != stated:
                raise InputError(
                    f"{path}: the chunk {entry.filename!r} unpacks to "
                    f"{'an unknown number of' if size is None else size} bytes, expected {stated}; "
                    "it is not opened"
                )


def unpacked_bytes(header: bytes) -> int | None:
    """What a Zstandard frame (RFC 8878) that begins with ``header`` says it unpacks to, ``None``
    where it does not say."""
    descriptor = header[4] if len(header) > 4 else 0
    single, width = bool(descriptor & 0x20), (0, 2, 4, 8)[descriptor >> 6]
    width = width or int(single)
    start = 5 + (not single) + (0, 1, 2, 4)[descriptor & 3]
    field = header[start : start + width]
    if not width or len(field) < width:
        return None
    return int.from_bytes(field, "little") + (256 if width == 2 else 0)
