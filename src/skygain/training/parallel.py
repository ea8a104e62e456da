"""Work beside work: gradients of a batch's shares, and batches made ahead of their use."""

from __future__ import annotations

__all__ = ["Shares", "moved", "prefetched"]

import copy
import functools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import Any

import torch
from torch import Tensor, nn

from skygain.training.tasks.base import Batch, Task


class Shares:
    """Data-parallel gradients: each worker takes its share of the batch through the same weights,
    with running statistics of its own. Use it in a ``with`` statement."""

    def __init__(
        self,
        task: Task,
        network: nn.Module,
        workers: int,
        autocast: Callable[[], Any],
        device: torch.device,
    ) -> None:
        self.task, self.autocast, self.device = task, autocast, device
        self.parameters = list(network.parameters())
        # deepcopy leaves alone what its memo holds already
        shared = {id(p): p for p in self.parameters}
        copies = (copy.deepcopy(network, dict(shared)) for _ in range(workers - 1))
        self.networks = [network, *copies]
        limit = functools.partial(torch.set_num_threads, 1) if workers > 1 else None
        self.pool = ThreadPoolExecutor(workers, initializer=limit)

    def __enter__(self) -> Shares:
        return self

    def __exit__(self, *error: object) -> None:
        self.pool.shutdown()

    def gradients(self, batch: Batch) -> Tensor:
        """Leave the gradient of the batch's mean loss in the parameters and return that loss."""
        n = len(self.networks)
        parts = [
            moved({key: value[i::n] for key, value in batch.items()}, self.device) for i in range(n)
        ]
        losses, gradients = zip(*self.pool.map(self._share, self.networks, parts), strict=True)
        total = list(gradients[0])
        for more in gradients[1:]:
            torch._foreach_add_(total, more)
        for p, gradient in zip(self.parameters, total, strict=True):
            # Fused Adam walks through memory, so a gradient must lie as its parameter does.
            alike = gradient.stride() == p.stride()
            p.grad = gradient if alike else torch.empty_like(p).copy_(gradient)
        with torch.no_grad():  # running statistics are those of all shares
            buffers = zip(*(network.named_buffers() for network in self.networks), strict=True)
            for same in buffers:
                if "running_" in same[0][0]:
                    mean = torch.stack([buffer for _, buffer in same]).mean(0)
                    for _, buffer in same:
                        buffer.copy_(mean)
        return torch.stack(losses).sum()

    def _share(self, network: nn.Module, part: Batch) -> tuple[Tensor, tuple[Tensor, ...]]:
        with self.autocast():
            loss = self.task.loss(network, part) / len(self.networks)
        return loss.detach(), torch.autograd.grad(loss, self.parameters)


def moved(batch: Batch, device: torch.device) -> Batch:
    """The batch on ``device``."""
    return {key: value.to(device, non_blocking=True) for key, value in batch.items()}


@contextmanager
def prefetched(
    make: Callable[[int], Batch], first: int, end: int, makers: int = 1
) -> Iterator[Iterator[Batch]]:
    """Iterator over ``make(k)`` for k in [first, end), made a few ahead in ``makers`` threads (the
    Numba kernels release the interpreter lock)."""
    numbers = iter(range(first, end))
    with ThreadPoolExecutor(makers) as pool:
        ahead = deque(pool.submit(make, k) for k in islice(numbers, makers + 2))

        def batches() -> Iterator[Batch]:
            while ahead:
                batch = ahead.popleft().result()
                ahead.extend(pool.submit(make, k) for k in islice(numbers, 1))
                yield batch

        try:
            yield batches()
        finally:
            pool.shutdown(cancel_futures=True)
