"""Chunks that would unpack to more than they should are not unpacked."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numcodecs.zstd import Zstd

from skygain.datasets import ChannelDataset, open_sample
from skygain.datasets.chunks import unpacked_bytes
from skygain.ground.errors import InputError


def sample_with(path: Path, name: str, content: bytes) -> Path:
    """The sample with another content of one entry."""
    with zipfile.ZipFile(open_sample().path) as old, zipfile.ZipFile(path, "w") as new:
        for entry in old.namelist():
            new.writestr(entry, content if entry == name else old.read(entry))
    return path


@pytest.mark.parametrize("size", [0, 1, 255, 256, 65_791, 65_792, 2**20, 2**24])
def test_a_frame_says_what_it_unpacks_to(size: int) -> None:
    assert unpacked_bytes(Zstd().encode(np.random.default_rng(0).bytes(size))[:18]) == size


def test_a_frame_written_to_a_pipe_does_not_say() -> None:
    assert unpacked_bytes(bytes.fromhex("28b52ffd0458190000").ljust(18, b"a")) is None


def test_a_bomb_is_named_and_not_unpacked(tmp_path: Path) -> None:
    bomb = Zstd().encode(bytes(2**30))
    assert len(bomb) < 100_000
    path = sample_with(tmp_path / "bomb.zarr.zip", "gain_db/c/0/1/0/0", bomb)
    with pytest.raises(InputError, match=r"'gain_db/c/0/1/0/0' unpacks to 1073741824 bytes"):
        ChannelDataset.open(path)


def test_other_packings_are_named(tmp_path: Path) -> None:
    with zipfile.ZipFile(open_sample().path) as archive:
        document = json.loads(archive.read("tx_m/zarr.json"))
    document["codecs"] = [document["codecs"][0], {"name": "gzip", "configuration": {"level": 5}}]
    content = json.dumps(document).encode()
    path = sample_with(tmp_path / "gzip.zarr.zip", "tx_m/zarr.json", content)
    with pytest.raises(InputError, match="packed with BytesCodec, GzipCodec"):
        ChannelDataset.open(path)
