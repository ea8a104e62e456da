"""The fit of the Kriging parameters finds a field's own, and goes on where it stopped."""

import json

import numpy as np
import pytest

from skygain.datasets.layout import CityRecord
from skygain.datasets.writer import write_dataset
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.predictors.kriging.parameters import TRENDS
from skygain.survey.methods import MethodSpec, predictor
from skygain.survey.origins import method_files
from skygain.testing.predictors import example_scenario
from skygain.training.kriging import KrigingConfig, train_kriging

QUICK = KrigingConfig(crop=32, flight_cells=60, scattered_cells=60, rounds=2)
SILL_DB2, RANGE_M, LOSS_DB = 60.0, 24.0, 30.0


@pytest.fixture(scope="module")
def fields(tmp_path_factory):
    """Twelve log-distance losses under correlated shadowing of known parameters."""
    rng, grid = np.random.default_rng(0), Grid((32, 32), 4.0)
    xy = grid.xy_m(grid.cells)
    distance_m = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    factor = np.linalg.cholesky(SILL_DB2 * np.exp(-distance_m / RANGE_M) + 1e-6 * np.eye(grid.size))
    records = []
    for number in range(12):
        tx_m = np.array([*rng.uniform(0, 124, 2), 1.5])
        away_m = np.sqrt(((xy - tx_m[:2]) ** 2).sum(axis=1) + (10.0 - 1.5) ** 2)
        gain = -40.0 - LOSS_DB * np.log10(away_m) + factor @ rng.normal(size=grid.size)
        records.append(
            CityRecord(
                number=number,
                split="T1",
                height_m=np.zeros(grid.shape),
                building=np.zeros((0, 5)),
                tx_m=tx_m[None],
                gain_db=gain.reshape(1, 1, *grid.shape),
                ray_traced=np.ones((1, 1, *grid.shape), dtype=bool),
            )
        )
    path = tmp_path_factory.mktemp("fields") / "fields.zarr.zip"
    return write_dataset(
        path, records, grid=grid, altitudes_m=[10.0], attributes={"frequency_hz": 5e9}
    )


def test_the_parameters_of_known_fields_are_found(tmp_path, fields):
    said = []
    result = train_kriging(fields, tmp_path / "k.json", QUICK, said.append)
    assert json.loads((tmp_path / "k.json").read_text()) == result
    assert set(result["trends"]) == set(TRENDS)
    found = result["trends"]["log-distance"]["10"]
    assert found["links"] == 12
    assert found["trend"][1] == pytest.approx(LOSS_DB, rel=0.25)
    assert found["range_m"] == pytest.approx(RANGE_M, rel=0.25)
    assert found["sill_db2"] == pytest.approx(SILL_DB2, rel=0.25)
    assert {line["trend"] for line in said} == set(TRENDS)


def test_a_stopped_fit_goes_on(tmp_path, fields):
    whole = train_kriging(fields, tmp_path / "whole.json", QUICK)
    last = [*TRENDS][-1]

    def stopped(record):
        if record["trend"] == last:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_kriging(fields, tmp_path / "parts.json", QUICK, stopped)
    said = []
    assert train_kriging(fields, tmp_path / "parts.json", QUICK, said.append) == whole
    assert {line["trend"] for line in said} == {last}
    with pytest.raises(InputError, match="other settings"):
        train_kriging(fields, tmp_path / "parts.json", KrigingConfig(crop=16))


@pytest.mark.parametrize("name", ["kriging", "kriging-blind", "kriging-inferred"])
def test_written_parameters_fly_by_their_file(tmp_path, fields, name):
    path = tmp_path / "k.json"
    trained = train_kriging(fields, path, QUICK)["trends"]
    made = predictor(f"{name}:parameters={path}")
    scenario = example_scenario()
    begun, shipped = (p.begin(scenario) for p in (made, predictor(name)))
    trend = "constant" if name == "kriging-blind" else "log-distance"
    assert begun.parameters.sill_db2 == trained[trend]["10"]["sill_db2"]
    assert begun.parameters.sill_db2 != shipped.parameters.sill_db2
    assert method_files(MethodSpec(f"{name}:parameters={path}", "lawnmower")).keys() == {"k.json"}


def test_other_files_are_no_parameters(tmp_path):
    other = tmp_path / "other.json"
    for text in ("{}", "no JSON", "[1]", json.dumps({"trends": {trend: {} for trend in TRENDS}})):
        other.write_text(text)
        with pytest.raises(InputError, match="skygain train kriging"):
            predictor(f"kriging:parameters={other}")
    with pytest.raises(InputError, match=r"nowhere\.json"):
        predictor("kriging:parameters=nowhere.json")
