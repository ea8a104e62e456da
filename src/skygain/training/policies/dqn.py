"""Multi-agent distributional Q-learning (paper, sections VI-D and VI-E): one network for all UAVs,
one replay memory.

The run is a function of its settings. Joint step k explores with the stream (seed, 1, k), update k
samples with (seed, 2, k), lane ℓ plays its episode e in the world (seed, ℓ, e). The checkpoint
holds the moves of the episodes under way, which are flown again when the run goes on.
"""

from __future__ import annotations

__all__ = ["train_dqn"]

import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from skygain.environments.surveys import SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.ground.errors import InputError
from skygain.networks.policies.inputs import moves_of
from skygain.networks.weights import runs_folder
from skygain.survey.methods import MethodSpec
from skygain.training.policies.demonstrations import Demonstrations
from skygain.training.policies.learner import DqnConfig, Learner
from skygain.training.policies.replay import Replay, ReplayConfig
from skygain.training.run import Report, Result, Run

Moves = NDArray[np.int64]


def train_dqn(config: DqnConfig, report: Report = lambda record: None) -> Result:
    """Fly and learn until ``total_steps`` or ``max_seconds``; every log record also goes to
    ``report``."""
    surveys = SurveyBatch(
        LinkWorlds(config.data, config.split, start=config.start, side=config.side),
        MethodSpec(config.predictor, "").build_predictor(),
        config.environment,
        config.lanes,
        seed=config.seed,
        transmitter_known=config.predictor.endswith("+tx"),
    )
    torch.manual_seed(config.seed)
    learner = Learner(config)
    none = np.full(surveys.cells.shape[:2], -1).tolist()
    run = Run(
        config.out,
        config,
        learner.parts,
        report,
        updates=0,
        last=none,  # moves
        lanes=[],
        # the same ones when the run goes on, whatever was flown since
        demonstrations=[],
    )
    if run.resumed:
        surveys.restore(run.state["lanes"])
    else:
        run.state["demonstrations"] = [str(file) for file in _demonstration_files(config)]
    if watched := [Path(file) for file in run.state["demonstrations"]]:
        learner.expert = Demonstrations.load(watched)
    if not run.resumed:
        learner.begin(report)
    memory = ReplayConfig(
        config.lanes,
        config.n_uavs,
        config.side,
        config.steps,
        config.capacity,
        config.checkpoint_steps,
    )
    replay = Replay(run.folder / "replay", memory, run.step)
    last = np.array(run.state["last"])
    recent: dict[str, list[float]] = {}

    def seen(**values: float | list[float]) -> None:
        for key, value in values.items():
            recent.setdefault(key, []).extend(value if isinstance(value, list) else [value])

    def save() -> None:
        replay.flush()
        run.state.update(last=last.tolist(), lanes=surveys.lanes_state())
        run.save()

    logged, logged_at = run.step, time.monotonic()
    while run.step < config.total_steps and not run.over:
        replay.remember(surveys, last)
        moves, q = learner.explored(
            surveys, last, np.random.default_rng([config.seed, 1, run.step])
        )
        held = surveys.cells.copy()
        result = surveys.step(moves)
        replay.complete(moves, result.reward, result.ended)
        last = _last_moves(held, surveys.cells, last, result.ended)
        seen(
            q=float(q.mean()),
            **{"return": result.returns[result.ended].tolist()},
            rmse_db=result.rmse_db[result.ended].tolist(),
        )
        run.step += 1
        if (
            run.step % config.learn_every == 0
            and len(replay) >= config.warmup
            and replay.written > config.n_steps
        ):
            rng = np.random.default_rng([config.seed, 2, run.state["updates"]])
            batch = replay.sample(rng, config.batch_size, config.n_steps, config.reward.discount)
            seen(**learner.update(batch, rng))
            run.state["updates"] += 1
            if run.state["updates"] % config.target_every == 0:
                learner.target.load_state_dict(learner.online.state_dict())
        if run.step % config.log_steps == 0:
            now = time.monotonic()
            rate = (run.step - logged) * config.lanes / max(now - logged_at, 1e-9)
            logged, logged_at = run.step, now
            run.scores = {key: round(float(np.mean(v)), 4) for key, v in recent.items() if v}
            recent.clear()
            run.record(
                updates=run.state["updates"],
                **run.scores,
                epsilon=config.exploration,
                joint_steps_per_second=round(rate, 1),
                transitions=len(replay),
            )
        if run.step % config.checkpoint_steps == 0:
            save()
    save()
    return run.result(run.state["updates"] * config.batch_size)


def _demonstration_files(config: DqnConfig) -> list[Path]:
    if not config.demonstrations:
        return []
    folders = (
        Path(config.demonstrations),
        runs_folder() / config.demonstrations / "demonstrations",
    )
    files = next((found for folder in folders if (found := sorted(folder.glob("*.npz")))), [])
    if not files:
        raise InputError(
            f"no demonstrations in {config.demonstrations}; make some with: skygain train policy "
            "--recipe imitation --data CITIES.zarr.zip"
        )
    return files


def _last_moves(held: Moves, cells: Moves, last: Moves, ended: NDArray[np.bool_]) -> Moves:
    """``[survey, uav]`` moves just made, −1 where a new episode has begun; a UAV that hovered keeps
    its last one."""
    made = moves_of(cells - held)
    return np.where(ended[:, None], -1, np.where(made < 0, last, made))
