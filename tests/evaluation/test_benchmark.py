"""Somebody without Skygain joins: the exported files are enough, and her row is the one that
Skygain's own metrics and rules of flight give."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from skygain.app.cli import command_line
from skygain.evaluation.benchmark import alone, score
from skygain.evaluation.benchmark.export import export_benchmark
from skygain.evaluation.benchmark.request import BenchmarkExportRequest
from skygain.evaluation.comparison import compare, request_cases
from skygain.evaluation.rollout import rollout
from skygain.evaluation.statistics import bootstrap_mean
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.survey.methods import MethodSpec

ROOT = Path(__file__).parents[2]
METHOD = MethodSpec("idw", "random-waypoint")
ASKED = BenchmarkExportRequest(max_surveys=3, steps=8, crop=40, noise_db=2.0, out="unused")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmark")
    export_benchmark(ASKED.comparison, folder)
    return folder


@pytest.fixture(scope="module")
def flown(exported: Path) -> tuple[Path, list[dict]]:
    """A rollout of Skygain's own, handed in as a submission."""
    benchmark, found = alone.Benchmark(exported), []
    folder = exported / "submissions" / "ours"
    for k, case in enumerate(request_cases(ASKED.comparison)[1]):
        kept = {}

        def observe(step, swarm, belief, kept=kept):
            kept[step] = (swarm.history, belief.measurements, belief.posterior())

        steps = benchmark.record_steps
        found.append(
            rollout(case, METHOD, steps=8, record_steps=steps, noise_db=2.0, observe=observe)
        )
        flight = benchmark.flight(k)
        for step, cells in enumerate(kept[8][0].transpose(1, 0, 2)[1:], start=1):
            flight.move(cells)
            if step in kept:
                flight.keep(kept[step][2].mean_db, kept[step][2].variance_db2)
        assert (flight.cells == kept[8][1].cell).all()
        assert (flight.gain_db == kept[8][1].gain_db).all(), "the same seed gives the same readings"
        flight.write(folder)
    return folder, found


def test_a_rollout_has_the_scores_that_evaluate_gives_it(
    exported: Path, flown: tuple[Path, list[dict]], tmp_path: Path
) -> None:
    """To the last digit, by the scorer that needs NumPy alone and by the command."""
    folder, found = flown
    benchmark = alone.Benchmark(exported)
    submission = alone.read_submission(benchmark, folder)
    outside, inside = alone.row(benchmark, submission), score._row(benchmark, submission)
    assert outside == inside
    asked = ASKED.comparison
    evaluated = compare(
        type(asked)(
            **{
                **asked.stored(),
                **{"predictors": ("idw",), "record_every": 2, "out": tmp_path, "workers": 1},
            }
        )
    )
    rmse = evaluated.scores[METHOD.label]["rmse_db"]
    assert [row["scores"]["rmse_db"] for row in found] == rmse[:, [0, 1, 3]].tolist()
    for k, value in zip([0, 1, 3], outside.values, strict=False):
        interval = bootstrap_mean(rmse[:, k], evaluated.cities)
        assert value == (interval.mean, interval.low, interval.high)
    cover = bootstrap_mean(evaluated.scores[METHOD.label]["coverage90"][:, -1], evaluated.cities)
    assert outside.values[-1] == (cover.mean, cover.low, cover.high)


def test_numpy_alone_is_enough_and_prints_the_row_of_the_command(exported: Path) -> None:
    script = (
        "import runpy, sys; sys.path.insert(0, '.'); runpy.run_path('example.py');"
        "import skygain_benchmark as b; b.main(['submissions/nearest-neighbour']);"
        "sys.exit(len({'skygain', 'scipy', 'numba'} & {*sys.modules}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=exported, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()
    printed = CliRunner().invoke(
        command_line(),
        ["benchmark", "score", str(exported / "submissions" / "nearest-neighbour")],
    )
    assert printed.output.endswith(done.stdout)
    assert "| nearest-neighbour | no | " in done.stdout


def test_the_page_shows_the_participant_that_is_shipped(exported: Path) -> None:
    page = (ROOT / "docs/how-to/join-the-benchmark.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert shown == (exported / "example.py").read_text(encoding="utf-8")
    assert len(shown.splitlines()) <= 45


FREE = np.ones((4, 5), dtype=bool)
FREE[1, 1] = False
PATHS = {
    "legal": ([(0, 0), (0, 1)], [(3, 4), (2, 4)], None),
    "jump": ([(0, 0), (0, 2)], [(3, 4), (2, 4)], "jumps"),
    "building": ([(0, 1), (1, 1)], [(3, 4), (2, 4)], "built up"),
    "off the map": ([(0, 0), (0, -1)], [(3, 4), (2, 4)], "off the map"),
    "shared": ([(2, 2), (2, 3)], [(2, 4), (2, 3)], "shares"),
    "swapped": ([(2, 2), (2, 3)], [(2, 3), (2, 2)], "swaps"),
    "hovering": ([(2, 2), (2, 2)], [(3, 4), (2, 4)], "hovers"),
}


@pytest.mark.parametrize("name", PATHS)
def test_the_rules_are_those_of_the_swarm(name: str) -> None:
    one, other, wrong = PATHS[name]
    paths = np.array([one, other])
    said = alone.illegal(FREE, paths)
    assert (said is None) == (wrong is None)
    assert wrong is None or wrong in said
    swarm = Swarm(FREE, 4.0, paths[:, :1], np.full(2, 1))
    if wrong is None:
        swarm.check(paths)
    else:
        with pytest.raises(ValueError, match="UAV"):
            swarm.check(paths)


def test_a_uav_without_a_way_may_hover() -> None:
    free = np.zeros((3, 3), dtype=bool)
    free[0, 0] = free[0, 1] = free[2, 2] = True
    paths = np.array([[(0, 0), (0, 0)], [(0, 1), (0, 1)], [(2, 2), (2, 2)]])
    assert alone.illegal(free, paths) is None
    Swarm(free, 4.0, paths[:, :1], np.full(3, 1)).check(paths)


def test_options_lead_to_legal_steps(exported: Path) -> None:
    rng = np.random.default_rng(1)
    flight = alone.Benchmark(exported).flight(0)
    while not flight.over:
        decided: dict = {}
        for uav in range(3):
            options = flight.options(uav, decided)
            decided[uav] = rng.choice(options) if len(options) else flight.paths[uav, -1]
        flight.move([decided[uav] for uav in range(3)])
    with pytest.raises(alone.BenchmarkError, match="all 8 steps"):
        flight.move(flight.paths[:, -1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(paths=a["paths"][:, :-1]), "paths of .* must have shape"),
        (lambda a: a["paths"].__setitem__((0, 3), (99, 99)), "jumps"),
        (lambda a: a["paths"].__iadd__(1), "do not begin at the starts"),
        (lambda a: a["variance_db2"].fill(-1.0), "variance_db2 must be 0 or more"),
        (lambda a: a["mean_db"].fill(np.nan), "mean_db must be .* dB in every free cell"),
        (lambda a: a["mean_db"].fill(1e200), "mean_db must be .* dB in every free cell"),
        (lambda a: a.update(mean_db=a["mean_db"].astype(str)), "mean_db of .* must hold numbers"),
        (lambda a: a.update(mean_db=a["mean_db"] + 1j), "mean_db of .* must hold numbers"),
        (lambda a: a.update(paths=a["paths"] + 0.5), "paths of .* must hold whole"),
        (lambda a: a.update(paths=a["paths"] * np.nan), "paths of .* must hold whole"),
        (lambda a: a.update(benchmark=np.array("other")), "belongs to benchmark other"),
        (lambda a: a.pop("mean_db"), "mean_db of .* got nothing"),
    ],
)
def test_what_cannot_be_scored_is_told(
    exported: Path, flown: tuple[Path, list[dict]], tmp_path: Path, change, message: str
) -> None:
    shutil.copytree(flown[0], tmp_path / "wrong")
    path = tmp_path / "wrong" / "case-001.npz"
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=message):
        score.score_submissions([tmp_path / "wrong"], exported)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda whole: whole[: len(whole) // 2], "damaged"),
        (lambda whole: whole[:2000] + bytes(500) + whole[2500:], "damaged"),
        (lambda whole: b"", "damaged"),
        (lambda whole: b"junk", "damaged"),
        (lambda whole: _saved(np.save, np.zeros(3)), "damaged"),
        (lambda whole: _saved(np.savez, np.array([None])), "something else than arrays"),
    ],
)
def test_a_damaged_file_is_named_without_a_traceback(
    exported: Path, flown: tuple[Path, list[dict]], tmp_path: Path, damage, message: str
) -> None:
    shutil.copytree(flown[0], tmp_path / "wrong")
    path = tmp_path / "wrong" / "case-001.npz"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=f"case-001.npz .*{message}") as told:
        score.score_submissions([tmp_path / "wrong"], exported)
    assert "pickle" not in str(told.value)


def _saved(save, values) -> bytes:
    file = io.BytesIO()
    save(file, values)
    return file.getvalue()


def test_paths_may_be_whole_floats(
    exported: Path, flown: tuple[Path, list[dict]], tmp_path: Path
) -> None:
    ours = tmp_path / flown[0].name
    shutil.copytree(flown[0], ours)
    for path in ours.iterdir():
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        np.savez(path, **arrays | {"paths": arrays["paths"].astype(float)})
    whole, floats = (score.score_submissions([one], exported) for one in (flown[0], ours))
    assert floats == whole


def test_misuse_of_the_commands_names_the_option(exported: Path, tmp_path: Path) -> None:
    def said(*words: str) -> str:
        with pytest.raises(InputError) as error:
            command_line().main(["benchmark", *words], standalone_mode=False)
        return str(error.value)

    assert "give another --out, or --overwrite" in said("export", "--out", str(exported))
    assert "give the exported folder as --benchmark" in said("score", str(tmp_path))
    gone = said("score", str(exported / "submissions" / "gone"))
    assert "gone is no folder" in gone
    assert "other is no folder" in said("score", str(tmp_path / "other"))
    assert "is the benchmark itself" in said("score", str(exported))
    (tmp_path / "README.md").write_text("mine")
    assert "README.md exists; give another --out" in said("export", "--out", str(tmp_path))
    assert "--steps must be 1 or more" in said("export", "--steps", "0", "--out", str(tmp_path))


def test_the_same_surveys_are_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        export_benchmark(ASKED.comparison, tmp_path / name / "benchmark.zip")
    a, b = ((tmp_path / name / "benchmark.zip").read_bytes() for name in "ab")
    assert a == b
