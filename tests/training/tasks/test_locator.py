"""The locator's pool is flown once, and its samples turn with their targets."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from skygain.datasets.layout import CityRecord
from skygain.datasets.writer import write_dataset
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.networks.operator.evidence import EVIDENCE_CHANNELS
from skygain.networks.operator.path_model import USED
from skygain.training.checkpoints import save_checkpoint
from skygain.training.pools import flown_cities
from skygain.training.tasks.locator import LocatorTask


def path_model(file, seed):
    """Random weights of a path model in ``file``."""
    rng, tensors = np.random.default_rng(seed), {}
    for i, (a, b) in enumerate(pairwise((len(USED), 8, 2))):
        tensors[f"{i}.weight"] = torch.from_numpy(rng.normal(size=(b, a)).astype(np.float32) / 4)
        tensors[f"{i}.bias"] = torch.zeros(b)
    save_checkpoint(file, tensors, {})


@pytest.fixture
def cities(tmp_path, rng):
    """Two small cities of three transmitters at three altitudes."""
    grid = Grid((40, 40), 4.0)
    height = np.zeros(grid.shape, dtype=np.float32)
    height[10:20, 12:25] = 25.0
    records = []
    for number, tx_m in enumerate(([[32.0, 120.0, 1.5], [120.0, 16.0, 1.5]], [[20.0, 20.0, 1.5]])):
        shape = (len(tx_m), 3, *grid.shape)
        records.append(
            CityRecord(
                number=number,
                split="T1",
                height_m=height,
                building=np.zeros((0, 5)),
                tx_m=np.array(tx_m),
                gain_db=rng.uniform(-120, -80, shape),
                ray_traced=np.ones(shape, dtype=bool),
            )
        )
    attributes = {"frequency_hz": 5e9}
    levels = [10.0, 20.0, 30.0]
    path = tmp_path / "cities.zarr.zip"
    return write_dataset(path, records, grid=grid, altitudes_m=levels, attributes=attributes)


def test_a_pool_is_flown_once_and_its_samples_turn_with_their_targets(tmp_path, cities):
    paths = tmp_path / "paths.safetensors"
    path_model(paths, 0)
    task, said = LocatorTask(side=32, flights=2, pool=str(tmp_path), paths=str(paths)), []
    pool = task.load(cities, "T1", said.append)
    assert len(pool) == 3 * 2 * 3
    assert said == [{"pool": "cities.zarr.zip", "split": "T1", "city": k, "of": 2} for k in (1, 2)]
    task.load(cities, "T1", said.append)
    assert len(said) == 2
    with pytest.raises(InputError, match="no map at an altitude wanted"):
        replace(task, altitude_odds=(0.0, 0.0, 0.0)).load(cities, "T1", said.append)
    with pytest.raises(InputError, match="maps of 40 x 40 cells are smaller than the 96 x 96"):
        replace(task, side=96).load(cities, "T1", said.append)
    path_model(paths, 1)
    pool = task.load(cities, "T1", said.append)
    assert len(said) == 4
    places = np.array([pool.sample(k, 0)[1].sum(axis=1) for k in range(len(pool))])
    assert len(np.unique(places.argmax(axis=1))) > 1
    twice = task.load([cities, cities], "T1", said.append)
    assert len(twice) == 2 * len(pool)
    assert np.array_equal(twice.sample(len(pool) + 3, 0)[0], pool.sample(3, 0)[0])
    for symmetry in range(8):
        maps, target = pool.sample(5, symmetry)
        assert np.isclose(target.sum(), 1, atol=1e-5)
        assert (target[maps[EVIDENCE_CHANNELS.index("open")] == 0] == 0).all()
        back = target.T if symmetry & 4 else target
        back = back[:, ::-1] if symmetry & 2 else back
        back = back[::-1] if symmetry & 1 else back
        assert np.allclose(back, pool.sample(5, 0)[1], atol=1e-6)
    batch = task.batch(pool, 4, np.random.default_rng(0))
    network = task.network()
    assert torch.isfinite(task.loss(network, batch))
    assert set(task.scores(network, [batch], torch.no_grad)) == {
        "cross_entropy",
        "log_near",
        "distance_m",
    }


def test_a_pool_is_the_same_with_any_number_of_workers(tmp_path, cities):
    path_model(tmp_path / "paths.safetensors", 0)
    task = LocatorTask(side=32, flights=1, paths=str(tmp_path / "paths.safetensors"))
    one, two = (
        flown_cities(
            "locator-pool",
            cities,
            "T1",
            task.fly_city,
            weights=(task.paths,),
            settings=None,
            stream=lambda path, city: [city],
            pool=tmp_path / str(workers),
            workers=workers,
        )
        for workers in (1, 2)
    )
    for first, second in zip(one, two, strict=True):
        for suffix in (".npz", ".maps.npy"):
            assert first.with_suffix(suffix).read_bytes() == second.with_suffix(suffix).read_bytes()
