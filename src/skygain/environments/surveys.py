"""Many surveys stepped together: the vectorised environment that learners train in.

Lane ℓ plays its episode k in a world drawn from the stream (seed, ℓ, k), so an episode is a
function of these three numbers and of the actions taken, whatever the other lanes do. A network
predictor is run once per step for all lanes; other beliefs are updated one by one.
"""

from __future__ import annotations

__all__ = ["EnvironmentConfig", "Step", "SurveyBatch"]

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.environments.rewards import RewardConfig, rewards
from skygain.environments.worlds import Episode, Worlds
from skygain.flight.airspace import Airspace, resolve_step
from skygain.flight.swarm import FlightRules, Swarm
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.networks.policies.planes import (
    action_masks,
    packed_height,
    packed_mean,
    packed_std,
    planes,
)
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.networks.network_belief import NetworkBelief, posteriors_together

PREFERENCE = np.array([0.0, -1.0, -2.0, -3.0]) * 1e-3
"""a UAV whose move is blocked by another one takes its first legal move in the order north, east,
south, west"""


@dataclass(frozen=True)
class EnvironmentConfig:
    """One kind of episode.

    Raises:
        InputError: fewer than one UAV or step.
    """

    n_uavs: int = 3
    """N"""
    steps: int = 200
    """T"""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """what is rewarded"""
    rules: FlightRules = FlightRules()
    """separation"""

    def __post_init__(self) -> None:
        if self.n_uavs < 1 or self.steps < 1:
            raise InputError(
                f"an environment needs n_uavs >= 1 and steps >= 1, got {self.n_uavs} and "
                f"{self.steps}"
            )


@dataclass(frozen=True, eq=False)
class Step:
    """What came of one joint step."""

    reward: NDArray[np.float32]
    """``[survey, uav]``"""
    ended: NDArray[np.bool_]
    """``[survey]`` whether T was reached; the lane is in its next episode already if the batch
    restarts by itself"""
    returns: NDArray[np.float64]
    """``[survey]`` sum of rewards of the mean UAV so far, of the episode that this step belongs
    to"""
    rmse_db: NDArray[np.float64]
    """``[survey]`` RMSE over unvisited outdoor cells after the step, NaN without a predictor"""


@dataclass(eq=False)
class _Lane:
    """One survey under way."""

    world: Episode
    swarm: Swarm
    belief: Belief | None
    outdoor: NDArray[np.bool_]
    returned: float = 0.0
    actions: list[NDArray[np.int64]] = field(default_factory=list)


class SurveyBatch:
    """``n_surveys`` surveys of equal shape. State changes in place; see `lanes_state` for how to
    save it."""

    def __init__(
        self,
        worlds: Worlds,
        predictor: Predictor | None,
        config: EnvironmentConfig | None = None,
        n_surveys: int = 1,
        *,
        seed: int = 0,
        transmitter_known: bool = False,
        restart: bool = True,
    ) -> None:
        """Begin the first episode of every lane.

        Args:
            worlds: where episodes come from.
            predictor: what maps the readings; ``None`` leaves mean and variance at zero and rewards
                exploration only.
            config: the kind of episode.
            n_surveys: lanes.
            seed: of everything that is random here.
            transmitter_known: tell the predictor the transmitter; always so if it cannot do
                without.
            restart: begin a lane's next episode as soon as one ends.
        """
        self.worlds, self.predictor, self.n_surveys = worlds, predictor, n_surveys
        config = self.config = config or EnvironmentConfig()
        self.seed, self.restart = seed, restart
        self._tells = transmitter_known or (
            predictor is not None and predictor.transmitter == "required"
        )
        shape = (n_surveys, worlds.side, worlds.side)
        self.mean, self.std, self.height = (np.zeros(shape, dtype=np.uint8) for _ in range(3))
        self.flyable = np.zeros(shape, dtype=bool)
        self.error_db, self.rmse_db = np.zeros(n_surveys), np.full(n_surveys, np.nan)
        self.cells = np.zeros((n_surveys, config.n_uavs, 2), dtype=np.int64)
        self.episode = np.zeros(n_surveys, dtype=np.int64)
        self._lanes = [self._begun(lane) for lane in range(n_surveys)]
        self._look(range(n_surveys))

    @property
    def steps_flown(self) -> NDArray[np.int64]:
        """``[survey]`` joint steps flown in the present episodes."""
        return np.array([lane.swarm.steps_flown for lane in self._lanes])

    @property
    def beliefs(self) -> list[Belief | None]:
        """``[survey]`` what is believed now."""
        return [lane.belief for lane in self._lanes]

    @property
    def swarms(self) -> list[Swarm]:
        """``[survey]`` where the UAVs are now."""
        return [lane.swarm for lane in self._lanes]

    def observations(self) -> NDArray[np.float32]:
        """``[survey, uav, plane, row, col]``, see `skygain.networks.policies.planes`."""
        n = self.config.n_uavs
        which = np.repeat(np.arange(self.n_surveys), n)
        uav = np.tile(np.arange(n), self.n_surveys)
        flat = planes(self.mean[which], self.std[which], self.height[which], self.cells[which], uav)
        return flat.reshape(self.n_surveys, n, *flat.shape[1:])

    def masks(self) -> NDArray[np.bool_]:
        """``[survey, uav, move]`` legal moves, other UAVs not regarded."""
        return action_masks(self.flyable, self.cells)

    def step(self, actions: ArrayLike) -> Step:
        """Fly ``actions[survey, uav]`` (0 to 3: north, east, south, west).

        A move into a building or off the map, or into the way of another UAV, is replaced by a
        legal one; UAVs choose in their order.

        Raises:
            InputError: actions of another shape or outside 0..3.
        """
        actions = np.asarray(actions, dtype=np.int64)
        if (
            actions.shape != (self.n_surveys, self.config.n_uavs)
            or actions.min() < 0
            or actions.max() > 3
        ):
            raise InputError(
                f"actions must be moves 0..3 of shape {(self.n_surveys, self.config.n_uavs)}, got "
                f"{actions.shape}"
            )
        before = self.error_db.copy()
        new = np.stack([self._moved(lane, actions[k]) for k, lane in enumerate(self._lanes)])
        self._look(range(self.n_surveys))
        ended = self.steps_flown >= self.config.steps
        reward = rewards(self.config.reward, new, ended, before, self.error_db)
        for lane, gained in zip(self._lanes, reward.mean(axis=1), strict=True):
            lane.returned += float(gained)
        step = Step(
            reward, ended, np.array([lane.returned for lane in self._lanes]), self.rmse_db.copy()
        )
        if self.restart and ended.any():
            over = np.flatnonzero(ended).tolist()
            self.begin_episodes(over, self.episode[over] + 1)
        return step

    def begin_episodes(self, lanes: Sequence[int], episodes: ArrayLike) -> None:
        """Put ``lanes`` at the start of the given ``episodes``."""
        self.episode[lanes] = episodes
        for k in lanes:
            self._lanes[k] = self._begun(k)
        self._look(lanes)

    def lanes_state(self) -> list[dict[str, Any]]:
        """For each lane the number of its episode and the actions taken in it: all it takes to come
        back here."""
        return [
            {"episode": int(k), "actions": [a.tolist() for a in lane.actions]}
            for k, lane in zip(self.episode, self._lanes, strict=True)
        ]

    def restore(self, state: Sequence[dict[str, Any]]) -> None:
        """Come back to what `lanes_state` described, by flying it again."""
        self.begin_episodes(range(self.n_surveys), [s["episode"] for s in state])
        # Lanes are looked at together, as they were the first time: a network's last bits depend on
        # the size of its batch.
        for t in range(max((len(s["actions"]) for s in state), default=0)):
            flown = [k for k, s in enumerate(state) if t < len(s["actions"])]
            before = self.error_db[flown].copy()
            new = np.stack(
                [
                    self._moved(self._lanes[k], np.asarray(state[k]["actions"][t], dtype=np.int64))
                    for k in flown
                ]
            )
            self._look(flown)
            gained = rewards(
                self.config.reward,
                new,
                np.zeros(len(flown), dtype=bool),
                before,
                self.error_db[flown],
            )
            for k, value in zip(flown, gained.mean(axis=1), strict=True):
                self._lanes[k].returned += float(value)

    def _begun(self, lane: int) -> _Lane:
        world = self.worlds.draw(
            np.random.default_rng([self.seed, lane, int(self.episode[lane])]), self.config.n_uavs
        )
        scenario = world.scenario if self._tells else world.scenario.without_transmitter()
        swarm = Swarm.deployed(scenario, world.start, self.config.steps, self.config.rules)
        belief = (
            None
            if self.predictor is None
            else self.predictor.begin(scenario).updated(_readings(world, swarm.cells))
        )
        self.height[lane], self.flyable[lane] = (
            packed_height(scenario.city.height_m),
            scenario.flyable,
        )
        self.cells[lane] = swarm.cells
        return _Lane(world, swarm, belief, np.asarray(scenario.outdoor))

    def _moved(self, lane: _Lane, actions: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Fly one joint step of one lane; ``[uav]`` who found a new cell."""
        swarm = lane.swarm
        score = np.tile(PREFERENCE, (swarm.n_uavs, 1))
        score[np.arange(swarm.n_uavs), actions] = 1.0
        then = np.empty((swarm.n_uavs, 2), dtype=np.int64)
        resolve_step(
            np.ascontiguousarray(swarm.cells), score, swarm.steps_left, 0, Airspace.of(swarm), then
        )
        moved = (then != swarm.cells).any(axis=1)
        new = moved & ~swarm.visited[then[:, 0], then[:, 1]]
        lane.swarm = swarm.advanced(then)
        if lane.belief is not None:
            lane.belief = lane.belief.updated(_readings(lane.world, then[moved]))
        lane.actions.append(actions)
        return new

    def _look(self, lanes: Sequence[int]) -> None:
        """Take the beliefs of ``lanes`` over into the arrays."""
        for k in lanes:
            self.cells[k] = self._lanes[k].swarm.cells
        if self.predictor is None:
            return
        for k, posterior in zip(
            lanes, _posteriors([self._lanes[k].belief for k in lanes]), strict=True
        ):
            lane = self._lanes[k]
            self.mean[k], self.std[k] = (
                packed_mean(posterior.mean_db),
                packed_std(posterior.variance_db2),
            )
            square = (posterior.mean_db - lane.world.truth_db) ** 2
            self.error_db[k] = np.sqrt(square[lane.outdoor].sum())
            self.rmse_db[k] = np.sqrt(square[lane.outdoor & ~lane.swarm.visited].mean())


def _readings(world: Episode, cells: NDArray[np.int64]) -> Measurements:
    return Measurements.at(cells, world.truth_db[cells[:, 0], cells[:, 1]].astype(float))


def _posteriors(beliefs: Sequence[Belief | None]) -> list[Posterior]:
    networks = [b for b in beliefs if isinstance(b, NetworkBelief)]
    if len(networks) == len(beliefs) and networks:
        return posteriors_together(networks)
    return [b.posterior() for b in beliefs if b is not None]
