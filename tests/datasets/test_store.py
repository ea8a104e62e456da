"""Reading and writing data sets, good and bad."""

from __future__ import annotations

import io
import json
import multiprocessing
import os
import pickle
import shutil
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.datasets import ChannelDataset, open_sample, write_dataset
from skygain.datasets.layout import VARIABLES, CityRecord
from skygain.datasets.links import load_links
from skygain.grid import Grid
from skygain.ground.errors import InputError

GRID = Grid((5, 6), 4.0, (3.0, 3.0))


def records(
    rng: np.random.Generator, links: tuple[int, ...] = (3, 0, 40), altitudes: int = 2
) -> list[CityRecord]:
    """Cities with the given numbers of links and any old numbers in them; one map is left out."""
    made = []
    for i, n in enumerate(links):
        gain = rng.uniform(-200, -60, (n, altitudes, *GRID.shape)).astype(np.float16)
        gain[:1, 1:] = np.nan
        made.append(
            CityRecord(
                number=1000 + i,
                split=("T1", "T2", "T4")[i],
                height_m=rng.integers(0, 40, GRID.shape).astype(np.float16),
                building=rng.uniform(0, 20, (i, 5)).astype(np.float32),
                tx_m=rng.uniform(0, 20, (n, 3)).astype(np.float32),
                gain_db=gain,
                ray_traced=rng.random(gain.shape) < 0.5,
            )
        )
    return made


def write(path: Path, made: list[CityRecord]) -> Path:
    return write_dataset(
        path,
        made,
        grid=GRID,
        altitudes_m=(10.0, 20.0),
        attributes={"frequency_hz": 5e9, "tool": "dice"},
    )


def test_what_is_written_is_read_back(tmp_path: Path, rng: np.random.Generator) -> None:
    made = records(rng)
    dataset = ChannelDataset.open(write(tmp_path / "d.zarr.zip", made))
    assert (dataset.grid, dataset.altitudes_m, dataset.attributes["tool"]) == (
        GRID,
        (10.0, 20.0),
        "dice",
    )
    for i, record in enumerate(made):
        again = dataset.record(i)
        for name, value in vars(record).items():
            np.testing.assert_array_equal(getattr(again, name), value, err_msg=name)
    assert dataset.links("T1", 10.0) == [0, 1, 2]
    assert dataset.links("T1", 20.0) == [1, 2]
    assert dataset.links("T2") == []
    assert len(dataset.links()) == 43


def test_equal_numbers_give_equal_bytes(tmp_path: Path) -> None:
    one, two = (
        write(tmp_path / name, records(np.random.default_rng(1))) for name in ("a.zip", "b.zip")
    )
    assert one.read_bytes() == two.read_bytes()


def test_a_link_carries_its_maps_and_city(tmp_path: Path, rng: np.random.Generator) -> None:
    made = records(rng)
    dataset = ChannelDataset.open(write(tmp_path / "d.zarr.zip", made))
    link = dataset.link(7, 20.0)
    assert (link.split, link.city_index, link.index, link.altitude_m) == ("T4", 2, 7, 20.0)
    np.testing.assert_array_equal(link.truth_db, made[2].gain_db[4, 1])
    np.testing.assert_array_equal(link.city.height_m, made[2].height_m)
    assert [b.height_m for b in link.city.buildings] == pytest.approx(made[2].building[:, 4])
    assert not link.truth_db.flags.writeable
    assert dataset.link(6).city is link.city


def test_the_layout_is_that_of_the_first_data_set(shared_data: Path, tmp_path: Path) -> None:
    first = ChannelDataset.open(shared_data / "manhattan-v0.zarr.zip")
    again = write_dataset(
        tmp_path / "again.zarr.zip",
        [first.record(i) for i in (0, 1, 299)],
        grid=first.grid,
        altitudes_m=first.altitudes_m,
        attributes=first.attributes,
    )
    theirs, ours = first.to_xarray(), ChannelDataset.open(again).to_xarray()
    assert set(theirs.variables) == set(ours.variables) == set(VARIABLES)
    for name in VARIABLES:
        assert (theirs[name].dims, theirs[name].dtype) == (ours[name].dims, ours[name].dtype), name
    assert theirs.attrs == ours.attrs
    for name in ("x", "y", "altitude", "axis", "edge"):
        np.testing.assert_array_equal(theirs[name], ours[name])
    chosen = theirs.gain_db.isel(link=np.isin(theirs.city_index, (0, 1, 299)))
    np.testing.assert_array_equal(chosen, ours.gain_db)


def test_polygons_and_raster_of_a_stored_city_agree(shared_data: Path) -> None:
    dataset = ChannelDataset.open(shared_data / "manhattan-v0.zarr.zip")
    city = dataset.city(3)
    assert (city.grid.shape, city.grid.spacing_m, city.grid.origin_m) == (
        (121, 121),
        4.0,
        (3.0, 3.0),
    )
    xy = city.grid.xy_m(city.grid.cells).reshape(121, 121, 2)
    inside = np.zeros(city.grid.shape, dtype=bool)
    for b in city.buildings:
        inside |= ((xy > b.footprint_m.min(axis=0)) & (xy < b.footprint_m.max(axis=0))).all(axis=-1)
    np.testing.assert_array_equal(inside, city.height_m > 0)


def _sum_of_link(args: tuple[ChannelDataset, int]) -> float:
    dataset, link = args
    return float(dataset.link(link).truth_db.sum())


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_one_data_set_serves_many_processes(method: str) -> None:
    dataset = open_sample()
    expected = [_sum_of_link((dataset, link)) for link in range(dataset.n_links)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # forking with threads about is what is tested here
        with multiprocessing.get_context(method).Pool(2) as pool:
            assert (
                pool.map(_sum_of_link, [(dataset, link) for link in range(dataset.n_links)])
                == expected
            )


def test_pickling_reopens_the_file() -> None:
    dataset = open_sample()
    copy = pickle.loads(pickle.dumps(dataset))
    np.testing.assert_array_equal(copy.link(0).truth_db, dataset.link(0).truth_db)


SAMPLE = open_sample().path.read_bytes()


def read_everything(path: Path) -> None:
    dataset = ChannelDataset.open(path)
    for i in range(dataset.n_cities):
        dataset.record(i)
        dataset.city(i)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_files_give_input_errors_and_nothing_else(
    tmp_path: Path, data: st.DataObject
) -> None:
    kind = data.draw(st.sampled_from(["cut", "garbage", "holes"]))
    if kind == "garbage":
        content = data.draw(st.binary(max_size=500))
    elif kind == "cut":
        content = SAMPLE[: data.draw(st.integers(0, len(SAMPLE) - 1))]
    else:
        damaged = bytearray(SAMPLE)
        for _ in range(data.draw(st.integers(1, 20))):
            damaged[data.draw(st.integers(0, len(SAMPLE) - 1))] ^= data.draw(st.integers(1, 255))
        content = bytes(damaged)
    path = tmp_path / "damaged.zarr.zip"
    path.write_bytes(content)
    message = None
    try:
        read_everything(path)
    except InputError as error:
        message = str(error)
    if message is None:
        assert (
            kind == "holes"
        )  # in a byte that nothing reads, such as a date in the zip file's directory
    else:
        assert str(path) in message
        assert "\n" not in message


def rewritten(path: Path, change: dict[str, bytes | None]) -> Path:
    """The sample with some entries replaced or taken out."""
    with zipfile.ZipFile(io.BytesIO(SAMPLE)) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = change.get(name, old.read(name))
            if content is not None:
                new.writestr(name, content)
    return path


def metadata(name: str, **change: object) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(SAMPLE)) as archive:
        document = json.loads(archive.read(f"{name}/zarr.json"))
    return {f"{name}/zarr.json": json.dumps(document | change).encode()}


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"gain_db/zarr.json": None}, "without the variable 'gain_db'"),
        ({"zarr.json": None}, "not a Skygain data set"),
        ({"zarr.json": b"[" * 100_000}, "not a Skygain data set"),
        (metadata("tx_m", dimension_names=["link", "metre"]), "expected tx_m"),
        (metadata("city_index", data_type="float32"), "expected city_index"),
        (metadata("height_m", shape=[7, 121, 120]), "has 121 along 'x', expected 120"),
        (metadata("height_m", shape=[10**9, 121, 121]), "height_m"),
        (
            metadata(
                "gain_db",
                chunk_grid={
                    "name": "regular",
                    "configuration": {"chunk_shape": [10**9, 1, 121, 121]},
                },
            ),
            "too large",
        ),
        (metadata("gain_db", codecs=[{"name": "pickle"}]), "not a Skygain data set"),
        ({"tx_m/c/0/0": b"nonsense"}, "damaged"),
        ({"gain_db/c/0/0/0/0": b"nonsense"}, "damaged"),
    ],
)
def test_files_of_another_layout_are_refused(
    tmp_path: Path, change: dict[str, bytes | None], hint: str
) -> None:
    with pytest.raises(InputError, match=hint):
        read_everything(rewritten(tmp_path / "other.zarr.zip", change))


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file"):
        ChannelDataset.open(tmp_path / "absent.zarr.zip")
    with pytest.raises(InputError, match="not a zip file"):
        ChannelDataset.open(tmp_path)
    text = tmp_path / "notes.txt"
    text.write_text("link,gain\n1,-80\n")
    with pytest.raises(InputError, match="not a zip file"):
        ChannelDataset.open(text)


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.zarr.zip"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("gain_db/c/0/0/0/0", "w") as entry,
    ):
        for _ in range(257):
            entry.write(bytes(2**20))
    with pytest.raises(InputError, match="not opened"):
        ChannelDataset.open(path)


def test_maps_that_no_memory_holds_are_refused(tmp_path: Path) -> None:
    """Chunks may be left out, so a small file can speak of any number of links."""
    many = 10**6
    change: dict[str, bytes | None] = {}
    for name, rest in {"city_index": [], "tx_m": [3], "gain_db": [3, 121, 121]}.items():
        shape = [many, *rest]
        grid = {"name": "regular", "configuration": {"chunk_shape": shape}}
        if name == "gain_db":
            change |= metadata("gain_db", shape=shape) | metadata("ray_traced", shape=shape)
        else:
            change |= metadata(name, shape=shape, chunk_grid=grid, fill_value=0)
            change[f"{name}/c/{'/'.join('0' for _ in shape)}"] = None
    with pytest.raises(InputError, match="GiB of memory; build data sets of fewer cities"):
        load_links(rewritten(tmp_path / "many.zarr.zip", change), "T1")


def test_nothing_is_left_behind_when_writing_fails(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    with pytest.raises(InputError, match="choose a folder"):
        write(tmp_path, records(rng))
    with pytest.raises(InputError, match="at least one link"):
        write(tmp_path / "d.zarr.zip", records(rng, (0,)))
    with pytest.raises(InputError, match="share grid and altitudes"):
        write(tmp_path / "d.zarr.zip", records(rng, altitudes=3))
    assert os.listdir(tmp_path) == []


def test_asking_for_what_is_not_there_names_what_is(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    dataset = ChannelDataset.open(write(tmp_path / "d.zarr.zip", records(rng)))
    for ask, hint in (
        (lambda: dataset.link(43), "links 0 to 42"),
        (lambda: dataset.link(0, 20.0), "not computed"),
        (lambda: dataset.link(0, 15.0), "it has 10, 20 m"),
        (lambda: dataset.city(3), "cities 0 to 2"),
        (lambda: dataset.links("T3"), "it has T1, T2, T4"),
    ):
        with pytest.raises(InputError, match=hint):
            ask()


def test_the_sample_is_small_and_has_every_split() -> None:
    dataset = open_sample()
    assert dataset.path.stat().st_size < 1_000_000
    assert dataset.splits == ("T1", "T2", "T3", "T4", "T4", "T4", "T4")
    for index in dataset.links():
        link = dataset.link(index)
        assert np.isfinite(link.truth_db[link.outdoor]).all()
        assert -300 < link.truth_db[link.outdoor].max() < 0


def test_the_sample_holds_generated_cities() -> None:
    dataset = open_sample()
    for i, seed in enumerate(dataset.city_numbers):
        np.testing.assert_array_equal(dataset.city(i).height_m, manhattan_city(seed).height_m)
        sites = transmitter_sites(manhattan_city(seed)).astype(np.float32)
        for transmitter in dataset.transmitters_m[dataset.city_index == i]:
            assert (sites == transmitter).all(axis=1).any()


def test_a_copy_of_the_sample_opens_anywhere(tmp_path: Path) -> None:
    path = shutil.copy(open_sample().path, tmp_path / "copy with blanks.zip")
    assert ChannelDataset.open(path).n_links == open_sample().n_links
