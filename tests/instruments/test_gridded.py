"""Readings brought onto a grid keep their place, their mean and an honest spread."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments import Recording, grid_for, on_grid, read_recording

GRID = Grid((10, 12), 4.0, (2.0, 2.0))


def recorded(xy, level, **more) -> Recording:
    return Recording(
        np.asarray(level, dtype=float), "gain", "made up", xy_m=np.asarray(xy, dtype=float), **more
    )


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 80))
def test_cells_hold_the_mean_of_their_distinct_readings(seed, n):
    rng = np.random.default_rng(seed)
    xy, level = rng.uniform(-6, 50, (n, 2)), rng.normal(-90, 10, n).round()
    xy[0] = 20.0
    gridded = on_grid(recorded(xy, level), GRID)
    cells = GRID.cells_at(xy)
    inside = GRID.contains(cells)
    assert gridded.outside == (~inside).sum()
    assert gridded.count.sum() == inside.sum()
    for k, cell in enumerate(gridded.cell):
        mine = inside & (cells == cell).all(axis=1)
        assert gridded.level_db[k] == pytest.approx(level[mine].mean())
        assert gridded.count[k] == gridded.distinct[k] == mine.sum()
        if mine.sum() > 1:
            assert gridded.spread_db[k] == pytest.approx(level[mine].std(ddof=1), abs=1e-9)
    assert (np.diff(GRID.flat(gridded.cell)) > 0).all()  # map order
    assert (gridded.recorded.sum(), len(gridded.measurements())) == (len(gridded), len(gridded))


def test_the_order_of_readings_does_not_matter():
    rng = np.random.default_rng(1)
    xy, level = rng.uniform(0, 48, (200, 2)), rng.normal(-90, 10, 200)
    order = rng.permutation(200)
    first, second = (
        on_grid(recorded(xy, level), GRID),
        on_grid(recorded(xy[order], level[order]), GRID),
    )
    assert first.level_db.tobytes() == second.level_db.tobytes()
    assert first.noise_std_db.tobytes() == second.noise_std_db.tobytes()


def test_copies_of_a_reading_bring_no_certainty_and_no_weight():
    xy, level = [[2, 2], [3, 3], [9, 9], [10, 9]], [-90.0, -94.0, -100.0, -98.0]
    once = on_grid(recorded(xy, level), GRID)
    often = on_grid(recorded([*xy, *[xy[0]] * 50], [*level, *[level[0]] * 50]), GRID)
    np.testing.assert_array_equal(often.level_db, once.level_db)
    np.testing.assert_array_equal(often.noise_std_db, once.noise_std_db)
    assert often.count.tolist() == [52, 2]
    assert often.distinct.tolist() == [2, 2]


def test_stated_standard_deviation_is_that_of_the_cell_means():
    # Cells of a flat field with 5 dB fading and different numbers of readings: errors over claims
    # are of size one.
    rng = np.random.default_rng(2)
    grid = Grid((60, 60), 4.0)
    count = rng.integers(1, 12, 3600)
    cell = np.repeat(np.arange(3600), count)
    xy = grid.xy_m(grid.cells[cell]) + rng.uniform(-1.9, 1.9, (len(cell), 2))
    gridded = on_grid(recorded(xy, rng.normal(-90, 5.0, len(cell))), grid, floor_std_db=0.0)
    z = (gridded.level_db + 90) / gridded.noise_std_db
    for low, high in ((1, 2), (3, 6), (7, 12)):
        some = (gridded.distinct >= low) & (gridded.distinct <= high)
        assert z[some].std() == pytest.approx(1.0, abs=0.08)


def test_no_cell_is_surer_than_the_floor():
    gridded = on_grid(
        recorded(np.random.default_rng(3).uniform(0, 4, (500, 2)), np.full(500, -90.0)),
        GRID,
        floor_std_db=1.5,
    )
    assert gridded.noise_std_db.tolist() == [1.5]


def test_stated_noise_is_believed():
    xy = [[2, 2], [2.5, 2.5], [6, 6]]
    gridded = on_grid(recorded(xy, [-90, -92, -95], noise_std_db=np.array([3.0, 4.0, 0.0])), GRID)
    assert gridded.noise_std_db.tolist() == [2.5, 0.0]


def test_a_cell_is_censored_when_all_its_readings_are():
    xy = [[2, 2], [2.5, 2.5], [6, 6]]
    gridded = on_grid(
        recorded(xy, [-150, -140, -150], censored=np.array([True, False, True])), GRID
    )
    assert gridded.censored.tolist() == [False, True]


def test_readings_off_the_map_are_counted_and_all_off_is_an_error():
    gridded = on_grid(
        recorded([[2, 2], [-3, 2], [49, 2], [np.inf, 0], [1e300, 0]], [-90] * 5), GRID
    )
    assert (len(gridded), gridded.outside) == (1, 4)
    with pytest.raises(
        InputError, match="all 2 readings of made up lie outside the map: they span x"
    ):
        on_grid(recorded([[-3, 2], [90, 2]], [-90, -91]), GRID)


def test_frames_must_agree():
    with pytest.raises(
        InputError, match="the map has a coordinate reference system and made up has none"
    ):
        on_grid(recorded([[2, 2]], [-90]), Grid((3, 3), 4.0, crs="EPSG:32617"))
    with pytest.raises(
        InputError, match="made up has a coordinate reference system and the map has none"
    ):
        on_grid(recorded([[2, 2]], [-90], crs="EPSG:32617"), GRID)
    with pytest.raises(InputError, match="has latitudes"):
        on_grid(
            Recording(np.array([-90.0]), "gain", "made up", latlon=np.array([[36.0, -78.9]])), GRID
        )
    with pytest.raises(InputError, match="floor_std_db"):
        on_grid(recorded([[2, 2]], [-90]), GRID, floor_std_db=-1)


LATLON = np.array([[36.0005, -78.9405], [36.0015, -78.9385], [35.9995, -78.9415]])


def test_grid_for_degrees_is_in_the_right_zone_and_holds_every_reading():
    pytest.importorskip("pyproj")
    recording = Recording(np.array([-90.0, -91, -92]), "power", "made up", latlon=LATLON)
    grid = grid_for(recording, 4.0)
    assert grid.crs == "EPSG:32617"
    gridded = on_grid(recording, grid)
    assert (len(gridded), gridded.outside) == (3, 0)
    # Every reading lies within half a cell's diagonal of the centre of its cell.
    centres = grid.xy_m(gridded.cell)
    metres = grid.xy_m_at_latlon(LATLON)
    assert (
        np.linalg.norm(metres[:, None] - centres[None], axis=-1).min(axis=1).max()
        <= 2 * np.sqrt(2) + 1e-6
    )


def test_maps_of_one_area_share_their_cells():
    pytest.importorskip("pyproj")
    first = grid_for(Recording(np.zeros(3) - 90, "gain", "a", latlon=LATLON), 4.0)
    second = grid_for(Recording(np.zeros(2) - 90, "gain", "b", latlon=LATLON[1:]), 4.0)
    offset = (np.array(first.origin_m) - second.origin_m) / 4.0
    np.testing.assert_allclose(offset, offset.round(), atol=1e-6)


def test_grid_for_a_local_frame_and_for_a_box():
    recording = recorded([[2, 3], [30, 40]], [-90, -91])
    grid = grid_for(recording, 5.0)
    assert grid.crs is None
    assert on_grid(recording, grid).outside == 0
    boxed = grid_for(recording, 5.0, box=(0, 0, 20, 20))
    assert boxed == Grid((4, 4), 5.0, (2.5, 2.5))
    assert on_grid(recording, boxed).outside == 1


def test_a_box_in_degrees_bounds_the_map():
    pytest.importorskip("pyproj")
    recording = Recording(np.array([-90.0, -91, -92]), "power", "made up", latlon=LATLON)
    grid = grid_for(recording, 4.0, box=(-78.942, 36.000, -78.938, 36.002))
    assert on_grid(recording, grid).outside == 1
    corner = grid.latlon([[0, 0]])[0]
    np.testing.assert_allclose(corner, [36.000, -78.942], atol=1e-4)


def test_boxes_and_spacings_that_make_no_sense():
    recording = recorded([[2, 3], [30, 40]], [-90, -91])
    with pytest.raises(InputError, match="`box` is"):
        grid_for(recording, 4.0, box=(20, 0, 0, 20))
    with pytest.raises(InputError, match="spacing_m"):
        grid_for(recording, 0.0)
    with pytest.raises(InputError, match="larger `spacing_m`"):
        grid_for(recorded([[0, 0], [1e7, 1e7]], [-90, -91]), 4.0)


def test_swapped_columns_are_noticed_on_the_map():
    pytest.importorskip("pyproj")
    eleven_east = np.add(LATLON, (0.0, 90.0))  # both orders are possible positions
    right = Recording(np.array([-90.0, -91, -92]), "power", "made up", latlon=eleven_east)
    wrong = Recording(right.level_db, "power", "made up", latlon=right.latlon[:, ::-1].copy())
    with pytest.raises(InputError, match="exchange the latitude and longitude columns"):
        on_grid(wrong, grid_for(right))


def test_real_campaign_on_the_authors_box(shared_data):
    # The reference counts are pandas' and pyproj's, taken from the same file.
    pandas, pyproj = pytest.importorskip("pandas"), pytest.importorskip("pyproj")
    path = shared_data / "duke_cbrs_abc.csv"
    x, y = pyproj.Transformer.from_crs(4326, 32617, always_xy=True).transform(-78.942737, 36.001483)
    grid = Grid((128, 128), 4.0, (x + 2, y - 510), "EPSG:32617")
    recording = read_recording(path, where={"PCI": "B", "device": "Pixel"})
    gridded = on_grid(recording, grid)
    table = pandas.read_csv(path).query("PCI == 'B' and device == 'Pixel'").drop_duplicates()
    assert len(recording) == 1359
    e, n = pyproj.Transformer.from_crs(4326, 32617, always_xy=True).transform(
        table.longitude, table.latitude
    )
    table = table.assign(
        col=np.floor((e - x) / 4).astype(int), row=np.floor((n - y + 512) / 4).astype(int)
    )
    means = table.query("0 <= row < 128 and 0 <= col < 128").groupby(["row", "col"]).rsrp.mean()
    assert gridded.cell.tolist() == [list(cell) for cell in means.index]
    np.testing.assert_allclose(gridded.level_db, means)


def test_real_loggers_write_copies(shared_data):
    # Why copies count once; docs/instruments.md quotes these numbers.
    recording = read_recording(shared_data / "duke_cbrs_abc.csv")
    lines = (shared_data / "duke_cbrs_abc.csv").read_text().splitlines()
    assert (len(recording), len(lines) - 1 - len(set(lines[1:]))) == (14110, 4845)
    held = np.zeros(3, dtype=int)
    for pci in "ABC":
        phone = read_recording(
            shared_data / "duke_cbrs_abc.csv", where={"PCI": pci, "device": "Samsung"}
        )
        pairs = np.column_stack([phone.latlon, phone.level_db])
        held += len(phone), len(np.unique(phone.latlon, axis=0)), len(np.unique(pairs, axis=0))
    assert held.tolist() == [6249, 4490, 4493]
