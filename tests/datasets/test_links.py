"""Links as arrays: windows turn with their transmitter, several data sets are one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skygain.datasets.links import joined, load_links, origin_of
from skygain.datasets.sample import SAMPLE, open_sample
from skygain.datasets.writer import write_dataset
from skygain.ground.errors import InputError


def test_a_view_turns_map_and_transmitterjoined():
    links = load_links(SAMPLE, "T1")
    plain = links.view(0, 0, 5, 9, 96)
    for symmetry in range(8):
        view = links.view(0, 0, 5, 9, 96, symmetry)
        # The strongest gain lies near the transmitter in every picture.
        near = np.unravel_index(
            np.where(view.outdoor, view.gain_db, -999).argmax(), view.gain_db.shape
        )
        plainly = np.unravel_index(
            np.where(plain.outdoor, plain.gain_db, -999).argmax(), plain.gain_db.shape
        )
        distance = np.hypot(near[0] - view.transmitter[0], near[1] - view.transmitter[1])
        assert np.isclose(
            distance, np.hypot(plainly[0] - plain.transmitter[0], plainly[1] - plain.transmitter[1])
        )
        assert np.isclose(view.height_m.sum(), plain.height_m.sum())


def test_several_data_sets_are_one():
    alone = load_links(SAMPLE, "T1")
    twice = load_links([SAMPLE, SAMPLE], "T1")
    assert (len(twice), len(twice.height_m)) == (2 * len(alone), 2 * len(alone.height_m))
    for k in range(len(alone)):
        one, two = alone.view(k, 0, 3, 4, 96), twice.view(len(alone) + k, 0, 3, 4, 96)
        assert one.transmitter == two.transmitter
        assert np.array_equal(one.gain_db, two.gain_db)
        assert np.array_equal(one.height_m, two.height_m)
    lower = replace(
        alone,
        altitude_m=alone.altitude_m[:1],
        gain_db=alone.gain_db[:, :1],
        ray_traced=alone.ray_traced[:, :1],
        available=alone.available[:, :1],
    )
    both = joined([lower, alone])
    assert np.array_equal(
        both.available, np.concatenate([[[True, False, False]] * len(alone), alone.available])
    )
    drawn = {
        both.draw(np.random.default_rng(k), 96, np.array([0.0, 1.0, 0.0])).altitude_m
        for k in range(20)
    }
    assert drawn == {20.0}
    with pytest.raises(InputError, match="maps at 10 m"):
        lower.draw(np.random.default_rng(0), 96, np.array([0.0]))
    with pytest.raises(InputError, match="maps of one size"):
        joined([alone, replace(alone, spacing_m=5.0)])


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(InputError, match="skygain dataset build"):
        load_links(tmp_path / "none.zarr.zip", "T1")
    with pytest.raises(InputError, match="no link of split 'T9'"):
        load_links(SAMPLE, "T9")


def test_damaged_training_data_is_one_line(tmp_path: Path) -> None:
    """Bytes turned anywhere, or the end cut off: read or refused, never anything else."""
    raw, refused = SAMPLE.read_bytes(), 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        damaged = bytearray(raw)
        for place in rng.integers(len(raw), size=int(rng.choice([1, 20]))):
            damaged[place] = int(rng.integers(256))
        end = len(raw) if seed % 5 else int(rng.integers(len(raw)))
        (tmp_path / "x.zarr.zip").write_bytes(damaged[:end])
        try:
            load_links(tmp_path / "x.zarr.zip", "T1")
        except InputError:
            refused += 1
    assert refused > 15


def test_data_sets_of_different_models_are_not_used_together(tmp_path):
    sample = open_sample()
    rays = {**sample.attributes["rays"], "model_version": -1}
    other = write_dataset(
        tmp_path / "other.zarr.zip",
        [sample.record(0)],
        grid=sample.grid,
        altitudes_m=sample.altitudes_m,
        attributes={**sample.attributes, "rays": rays},
    )
    assert len(load_links(other, "T1")) == len(load_links(SAMPLE, "T1"))
    assert origin_of(other) != origin_of(SAMPLE) == origin_of([SAMPLE, SAMPLE])
    with pytest.raises(InputError, match=r"must come from one propagation model.*launch -1"):
        load_links([SAMPLE, other], "T1")
