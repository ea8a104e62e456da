"""The DQN's settings and its learner: online and target network, exploration and updates.

Deep Q-learning from demonstrations (Hester et al., 2018) is an option: before the first step, and
beside the temporal-difference loss of every update, the network learns to value the move of an
expert most, by the cross entropy of softmax(Q/τ) over the legal moves.
"""

from __future__ import annotations

__all__ = ["DqnConfig", "Learner"]

from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.environments.rewards import RewardConfig
from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.grid import SYMMETRIES
from skygain.ground.errors import InputError
from skygain.networks.policies.inputs import Seen, turned_moves
from skygain.networks.policies.network import POLICY_NETWORKS, policy_network
from skygain.networks.policies.weights import policy_file
from skygain.networks.weights import read_weights
from skygain.training.compute import autocast
from skygain.training.policies.c51 import cross_entropy, expected, masked_argmax, projected, support
from skygain.training.policies.demonstrations import Demonstrations
from skygain.training.policies.imitation import expert_loss
from skygain.training.policies.replay import Transitions
from skygain.training.run import Part, Report, under

Moves = NDArray[np.int64]


@dataclass(frozen=True)
class DqnConfig:
    """One run.

    Raises:
        InputError: an unknown network, or numbers that cannot be.
    """

    data: str = "sample"
    """path of the data set"""
    out: str = ""
    """folder of the run: checkpoint.safetensors, log.jsonl, config.json, replay/; an existing
    checkpoint is continued"""
    predictor: str = "paper-unet"
    """predictor text as in `skygain.survey.methods`; ``+tx`` tells it the transmitter"""
    network: str = "paper"
    """``"paper"`` or ``"centred"``"""
    dueling: bool = False
    """split into value and advantage (centred network only)"""
    double: bool = False
    """the online network chooses the next move, the target network judges it"""
    split: str = "T3"
    """split to fly in"""
    start: str = "cluster"
    """kind of start"""
    side: int = 96
    """cells along the edge of the map"""
    n_uavs: int = 3
    """N"""
    steps: int = 200
    """T"""
    lanes: int = 8
    """surveys flown together"""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """r_e, r_r, γ and whether rewards are shaped"""
    v_min: float = -20.0
    """lower end of the returns' support"""
    v_max: float = 5.0
    """upper end of it"""
    atoms: int = 40
    """N_a"""
    n_steps: int = 5
    """M"""
    exploration: float = 0.03
    """ε; random moves are legal ones"""
    learning_rate: float = 1e-5
    """of Adam"""
    adam_epsilon: float = 1e-8
    """of Adam; the paper gives one for the predictor only"""
    batch_size: int = 256
    """transitions per update"""
    learn_every: int = 4
    """τ_L, joint steps of the batch of surveys between updates"""
    target_every: int = 1000
    """τ_DQN, updates between copies to the target network"""
    warmup: int = 5000
    """transitions in the memory before learning begins"""
    capacity: int = 6_000_000
    """transitions in the memory"""
    augment: bool = False
    """turn and mirror what is sampled, all eight ways at random"""
    bf16: bool = True
    """bfloat16 autocast where the CPU has it"""
    start_from: str = ""
    """name or file of a policy whose tensors, as far as they fit, begin this run"""
    demonstrations: str = ""
    """flights of an expert: the name of an imitation run, or a folder of its demonstrations; none
    if empty"""
    demonstration_weight: float = 0.0
    """λ, of the expert's cross entropy beside the temporal-difference loss"""
    temperature: float = 0.05
    """τ, difference in value that counts as a clear preference"""
    pretraining: int = 0
    """updates on demonstrations alone before the first step, at ten times the learning rate"""
    seed: int = 0
    """of everything"""
    total_steps: int = 1_000_000
    """joint steps per lane after which the run is over"""
    max_seconds: float = float("inf")
    """stop this call after so long"""
    checkpoint_steps: int = 2000
    """joint steps per lane between checkpoints"""
    log_steps: int = 50
    """joint steps per lane between lines of the log"""

    def __post_init__(self) -> None:
        if self.network not in POLICY_NETWORKS:
            raise InputError(
                f"unknown policy network {self.network!r}; known: {', '.join(POLICY_NETWORKS)}"
            )
        if (self.pretraining or self.demonstration_weight) and not self.demonstrations:
            raise InputError(
                "learning from demonstrations needs a folder of them; make one with: skygain train "
                "policy --recipe imitation"
            )
        if (
            self.n_steps < 1
            or self.atoms < 2
            or not self.v_min < self.v_max
            or not 0 <= self.exploration <= 1
        ):
            raise InputError(
                "a DQN needs n_steps >= 1, atoms >= 2, v_min < v_max and exploration in 0..1"
            )

    @property
    def environment(self) -> EnvironmentConfig:
        """The kind of episode."""
        return EnvironmentConfig(self.n_uavs, self.steps, self.reward)


class Learner:
    """See the module."""

    def __init__(self, config: DqnConfig) -> None:
        """Networks with weights from PyTorch's global generator."""
        self.config = config
        keys = ("network", "atoms", "side", "dueling")
        shape = {key: getattr(config, key) for key in keys}
        self.online, self.target = policy_network(shape), policy_network(shape)
        self.optimiser = torch.optim.Adam(
            self.online.parameters(), config.learning_rate, eps=config.adam_epsilon
        )
        self.support = support(config.v_min, config.v_max, config.atoms)
        self.autocast = autocast(config.bf16)
        self.expert: Demonstrations | None = None

    @property
    def parts(self) -> dict[str, Part]:
        """What a checkpoint keeps."""
        return {"network": self.online, "target": self.target, "optimiser": self.optimiser}

    def begin(self, report: Report) -> None:
        """What precedes the first step: weights of another policy, updates on demonstrations alone
        at ten times the learning rate. A run killed here begins again."""
        config = self.config
        if config.start_from:
            _warm_start(self.online, config.start_from)
        optimiser = torch.optim.Adam(
            self.online.parameters(), 10 * config.learning_rate, eps=config.adam_epsilon
        )
        agreements = []
        for k in range(config.pretraining):
            rng = np.random.default_rng([config.seed, 3, k])
            loss, agreed = self._expert_loss(rng, self._symmetry(rng))
            _step(optimiser, loss)
            agreements.append(float(agreed))
            if (k + 1) % config.log_steps == 0:
                share = round(float(np.mean(agreements)), 4)
                report({"pretraining": k + 1, "of": config.pretraining, "agreement": share})
                agreements.clear()
        self.target.load_state_dict(self.online.state_dict())

    def explored(
        self, surveys: SurveyBatch, last: Moves, rng: np.random.Generator
    ) -> tuple[Moves, NDArray[np.float32]]:
        """ε-greedy moves ``[survey, uav]`` and the value of the best move, ``last[survey, uav]``
        being the moves before."""
        lanes, n = last.shape
        which, uav = np.repeat(np.arange(lanes), n), np.tile(np.arange(n), lanes)
        seen = Seen(
            mean=surveys.mean[which],
            std=surveys.std[which],
            height=surveys.height[which],
            flyable=surveys.flyable[which],
            cells=surveys.cells[which],
            uav=uav,
            last=last.ravel(),
            left=self.config.steps - surveys.steps_flown[which],
        )
        masks = surveys.masks().reshape(-1, 4)
        with torch.inference_mode(), self.autocast():
            logits = self.online(*self.online.inputs(seen))  # type: ignore[operator]
        q = expected(logits, self.support)
        best = masked_argmax(q, torch.from_numpy(masks)).numpy()
        legal = np.argmax(masks * (0.5 + rng.random(masks.shape)), axis=1)
        moves = np.where(rng.random(len(best)) < self.config.exploration, legal, best)
        return moves.reshape(lanes, n), q.numpy()[np.arange(len(best)), best]

    def update(self, batch: Transitions, rng: np.random.Generator) -> dict[str, float]:
        """One update; the temporal-difference loss, and with demonstrations the share of the
        expert's moves that the network makes."""
        symmetry = self._symmetry(rng)
        turned = turned_moves(symmetry)
        with torch.no_grad(), self.autocast():
            then = self.online.inputs(batch.then, symmetry)  # type: ignore[operator]
            logits = self.target(*then)
            judge = self.online(*then) if self.config.double else logits
        with torch.no_grad():
            mask = torch.from_numpy(batch.mask[:, np.argsort(turned)])
            best = masked_argmax(expected(judge, self.support), mask)
            goal = projected(
                torch.softmax(logits[torch.arange(len(best)), best], dim=-1),
                torch.from_numpy(batch.reward),
                torch.from_numpy(batch.discount),
                self.support,
            )
        with self.autocast():
            logits = self.online(*self.online.inputs(batch.now, symmetry))  # type: ignore[operator]
        loss = total = cross_entropy(logits, torch.from_numpy(turned[batch.move]), goal).mean()
        found = {"loss": float(loss.detach())}
        if self.expert is not None and self.config.demonstration_weight:
            entropy, agreed = self._expert_loss(rng, symmetry)
            total = loss + self.config.demonstration_weight * entropy
            found["agreement"] = float(agreed)
        _step(self.optimiser, total)
        return found

    def _symmetry(self, rng: np.random.Generator) -> int:
        return int(rng.integers(SYMMETRIES)) if self.config.augment else 0

    def _expert_loss(self, rng: np.random.Generator, symmetry: int) -> tuple[Tensor, Tensor]:
        """`expert_loss` with the values of the moves in units of τ as their logits."""
        assert self.expert is not None
        config = self.config
        return expert_loss(
            self.online,
            self.expert,
            rng,
            config.batch_size,
            symmetry,
            lambda logits: expected(logits, self.support) / config.temperature,
        )


def _step(optimiser: torch.optim.Optimizer, loss: Tensor) -> None:
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    optimiser.step()


def _warm_start(network: nn.Module, file: str) -> None:
    """Take over the tensors of a policy, or of a run's checkpoint, that have the same name and
    shape."""
    state = network.state_dict()
    path = policy_file(file)
    tensors = {key: torch.from_numpy(a) for key, a in read_weights(path).arrays.items()}
    tensors = under("network.", tensors) or tensors
    if not any(key in state and state[key].shape == value.shape for key, value in tensors.items()):
        raise InputError(
            f"nothing in {path} fits the network of this run; give the weights of a policy with "
            "the same kind of network"
        )
    network.load_state_dict(
        {
            key: tensors[key] if key in tensors and tensors[key].shape == value.shape else value
            for key, value in state.items()
        }
    )
