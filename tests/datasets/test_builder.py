"""Building data sets: reproducible however it is done, and whatever is done to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.datasets import ChannelDataset, build_dataset, describe_dataset, survey_cases
from skygain.datasets.builder import _locked
from skygain.datasets.links import load_links
from skygain.datasets.presets import PRESETS, BuildConfig, preset_config
from skygain.datasets.summary import dataset_info
from skygain.ground.errors import InputError

FAST = BuildConfig(
    name="fast",
    cities=(3, 1, 0, 2),
    max_sites=2,
    altitudes_m=(10.0, 20.0),
    propagation="gudmundson",
)
"""six cities without a ray tracer"""

SCRIPT = """
import sys
from skygain.datasets.builder import build_dataset
from skygain.datasets.presets import BuildConfig
config = BuildConfig(
    name="fast", cities=(3, 1, 0, 2), max_sites=2, altitudes_m=(10.0, 20.0),
    propagation="gudmundson",
)
if __name__ == "__main__":
    def told(done, *_):
        print(done, flush=True)
    build_dataset(config, sys.argv[1], workers=int(sys.argv[2]), progress=told)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set that every other way of building must reproduce."""
    return build_dataset(FAST, tmp_path_factory.mktemp("built") / "fast.zarr.zip")


def test_the_file_holds_the_generated_cities(built: Path) -> None:
    dataset = ChannelDataset.open(built)
    assert dataset.splits == ("T1", "T1", "T1", "T2", "T4", "T4")
    assert dataset.city_numbers == (0, 1, 2, 1000, 3000, 3001)
    assert dataset.altitudes_m == (10.0, 20.0)
    for i, seed in enumerate(dataset.city_numbers):
        stored, made = dataset.city(i), manhattan_city(seed)
        assert stored.grid == made.grid
        np.testing.assert_array_equal(stored.height_m, made.height_m)
        for b, c in zip(stored.buildings, made.buildings, strict=True):
            np.testing.assert_array_equal(b.footprint_m, c.footprint_m)
            assert b.height_m == c.height_m
        sites = {tuple(site) for site in transmitter_sites(made).astype(np.float32).tolist()}
        assert {tuple(t) for t in dataset.transmitters_m[dataset.city_index == i].tolist()} <= sites
    for index in dataset.links("T4", 20.0):
        link = dataset.link(index, 20.0)
        assert np.isfinite(link.truth_db[link.outdoor]).all()
    assert not built.with_name("fast.zarr.zip.parts").exists()


def test_surveys_can_be_drawn_from_it(built: Path) -> None:
    cases = survey_cases(ChannelDataset.open(built), "T4", max_surveys=2)
    assert len({case.city_index for case in cases}) == 2
    assert cases[0].scenario().transmitter_m is not None


def test_more_workers_give_the_same_bytes(built: Path, tmp_path: Path) -> None:
    told = []
    again = build_dataset(
        FAST, tmp_path / "two.zarr.zip", workers=2, progress=lambda *state: told.append(state)
    )
    assert again.read_bytes() == built.read_bytes()
    assert [done for done, _, _ in told] == list(range(7))
    assert {total for _, total, _ in told} == {6}
    assert told[-1][2] == 0


def building(script: Path, path: Path, workers: int, until: int) -> subprocess.Popen[str]:
    """A process that builds FAST and has finished so many cities."""
    command = [sys.executable, str(script), str(path), str(workers)]
    build = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert build.stdout is not None
    for line in build.stdout:
        if int(line) >= until:
            break
    return build


def wait_until_all_have_ended(group: int) -> None:
    """Workers must not outlive the build that they work for."""
    for _ in range(400):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("a worker outlived the build by 20 seconds")


def test_a_killed_build_goes_on_to_the_same_bytes(built: Path, tmp_path: Path) -> None:
    script, path = tmp_path / "script.py", tmp_path / "killed.zarr.zip"
    script.write_text(SCRIPT)
    rng = np.random.default_rng(5)
    for workers, cities in ((2, 1), (1, 4)):
        build = building(script, path, workers, until=cities)
        time.sleep(float(rng.uniform(0, 0.05)))  # into whatever it does next
        build.kill()
        assert build.wait() == -signal.SIGKILL
        wait_until_all_have_ended(build.pid)
    left = sorted((tmp_path / "killed.zarr.zip.parts").glob("city-*.zarr.zip"))
    told = []
    build_dataset(FAST, path, workers=2, progress=lambda done, *_: told.append(done))
    assert told[0] == len(left) >= 4
    assert path.read_bytes() == built.read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["killed.zarr.zip", "script.py"]


def test_a_damaged_part_is_made_again(built: Path, tmp_path: Path) -> None:
    path, two = tmp_path / "d.zarr.zip", replace(FAST, cities=(1, 0, 0, 1))
    with pytest.raises(KeyboardInterrupt):
        build_dataset(two, path, progress=_interrupt_after(2))
    shard = tmp_path / "d.zarr.zip.parts" / "city-3000.zarr.zip"
    whole = shard.read_bytes()
    shard.write_bytes(whole[:1000])
    done = []
    build_dataset(two, path, progress=lambda count, *_: done.append(count))
    assert done == [1, 2]
    np.testing.assert_array_equal(
        ChannelDataset.open(path).record(1).gain_db, ChannelDataset.open(built).record(4).gain_db
    )


def _interrupt_after(cities: int):  # type: ignore[no-untyped-def]
    def progress(done: int, total: int, seconds_left: float | None) -> None:
        if done >= cities:
            raise KeyboardInterrupt

    return progress


def test_a_finished_build_is_left_alone(built: Path) -> None:
    before = built.stat().st_mtime_ns
    build_dataset(FAST, built, progress=_interrupt_after(0))
    assert built.stat().st_mtime_ns == before
    assert not built.with_name("fast.zarr.zip.parts").exists()


def test_other_settings_do_not_mix(tmp_path: Path, built: Path) -> None:
    with pytest.raises(InputError, match=r"other settings \(max_sites 2 there, 1 now"):
        build_dataset(replace(FAST, max_sites=1), built)
    path, one = tmp_path / "d.zarr.zip", replace(FAST, cities=(1, 0, 0, 0))
    with pytest.raises(KeyboardInterrupt):
        build_dataset(one, path, progress=_interrupt_after(0))
    with pytest.raises(InputError, match=r"other settings \(seed 0 there, 1 now"):
        build_dataset(replace(one, seed=1), path)
    note = tmp_path / "d.zarr.zip.parts" / "settings.json"
    note.write_text(json.dumps(json.loads(note.read_text()) | {"source": "0123"}))
    with pytest.raises(InputError, match="source '0123' there"):
        build_dataset(one, path)
    other = build_dataset(replace(one, seed=1), path, resume=False)
    assert ChannelDataset.open(other).n_cities == 1
    assert os.listdir(tmp_path) == ["d.zarr.zip"]


def test_two_builds_of_one_file_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "d.zarr.zip"
    with (
        _locked(tmp_path / "d.zarr.zip.parts", path),
        pytest.raises(InputError, match="another process is building"),
    ):
        build_dataset(FAST, path)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({"preset": "huge"}, "known: paper, light, small, tiny"),
        ({"preset": "tiny", "propagation": "magic"}, "known"),
        ({"preset": "tiny", "workers": 0}, "1 or more"),
    ],
)
def test_impossible_builds_are_refused_at_once(tmp_path: Path, options: dict, hint: str) -> None:
    with pytest.raises(InputError, match=hint):
        build_dataset(path=tmp_path / "d.zarr.zip", **options)
    assert os.listdir(tmp_path) == []


def test_unusable_paths_are_refused_at_once(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("do not overwrite")
    with pytest.raises(InputError, match="choose a folder"):
        build_dataset(FAST, notes / "d.zarr.zip")
    with pytest.raises(InputError, match="is a folder"):
        build_dataset(FAST, tmp_path)
    with pytest.raises(InputError, match="not a zip file"):
        build_dataset(FAST, notes)
    assert notes.read_text() == "do not overwrite"
    assert os.listdir(tmp_path) == ["notes.txt"]


def test_the_paper_preset_is_the_protocol() -> None:
    paper = preset_config("paper")
    assert paper.cities == (75, 25, 170, 30)
    assert paper.altitudes_m == (10.0, 20.0, 30.0)
    assert paper.max_sites is None


def test_a_city_belongs_to_one_split_whatever_the_preset() -> None:
    split: dict[int, str] = {}
    for config in PRESETS.values():
        for seed, name in config.city_seeds:
            assert split.setdefault(seed, name) == name
        assert len(dict(config.city_seeds)) == sum(config.cities)


@pytest.mark.parametrize(
    "change",
    [{"cities": (0, 0, 0, 0)}, {"cities": (1001, 0, 0, 0)}, {"max_sites": 0}, {"altitudes_m": ()}],
)
def test_a_configuration_out_of_range_is_refused(change: dict) -> None:
    with pytest.raises(InputError, match="got BuildConfig"):
        replace(FAST, **change)


def test_the_summary_counts_what_is_there(built: Path) -> None:
    info = dataset_info(built)
    dataset = ChannelDataset.open(built)
    assert info["cities"] == {"T1": 3, "T2": 1, "T4": 2}
    assert sum(info["links"].values()) == dataset.n_links
    links = [dataset.link(i, 20.0) for i in dataset.links(None, 20.0)]
    gains = np.concatenate([link.truth_db[link.outdoor] for link in links])
    assert info["altitudes"]["20"]["outdoor_share"] == pytest.approx(
        np.mean([link.outdoor.mean() for link in links])
    )
    for name, value in info["altitudes"]["20"]["gain_db"].items():
        assert value == pytest.approx(np.percentile(gains, float(name.rstrip("%"))), abs=0.2)
    json.dumps(info)
    assert "T4          2" in describe_dataset(built)


def test_large_maps_are_built_and_surveyed_whole(tmp_path: Path) -> None:
    """The preset for many UAVs: more than 250 cells a side, streets and buildings as in the small
    cities, a gain everywhere outdoors."""
    large = replace(preset_config("large"), cities=(0, 1, 0, 0))
    dataset = ChannelDataset.open(build_dataset(large, tmp_path / "large.zarr.zip"))
    assert min(dataset.grid.shape) >= 250
    assert dataset.attributes["build"]["city"]["blocks"] == 10
    case = survey_cases(dataset, "T2", n_uavs=50, crop_shape=dataset.grid.shape)[0]
    assert case.truth_db.shape == dataset.grid.shape
    assert len(set(case.starts)) == 50
    assert np.isfinite(case.truth_db[case.scenario().outdoor]).all()
    assert 0.2 < 1 - case.scenario().outdoor.mean() < 0.5


def test_sets_of_different_models_are_not_taken_together(built: Path, tmp_path: Path) -> None:
    other = build_dataset(
        replace(FAST, cities=(1, 0, 0, 0), propagation="over-rooftop"), tmp_path / "other.zarr.zip"
    )
    assert len(load_links([built, built], "T1")) == 2 * len(load_links(built, "T1"))
    with pytest.raises(InputError, match=r"one propagation model.*gudmundson.*over-rooftop"):
        load_links([built, other], "T1")


def test_gains_are_stored_in_quarters_of_a_decibel(built: Path) -> None:
    gain = ChannelDataset.open(built).link(0).truth_db
    assert np.array_equal(gain * 4, np.rint(gain * 4))
