"""Readings that vehicles send over their links, brought into the journal as they come.

A thread of its own does it, so that no planning holds readings up and no death of the process loses
more than the last moment. On a full disk they wait in memory, and the flight goes on.
"""

from __future__ import annotations

__all__ = ["Keeper"]

import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from skygain.ground.errors import InputError
from skygain.missions.journal import Journal, Reading, Stream
from skygain.missions.vehicle_link import VehicleLink

_EVERY_S = 0.1
_AT_ONCE = 5000


class Keeper:
    """Keeps what the links hear for the length of a block.

    Args:
        path: the journal.
        sortie: number of the sortie that is flown.
        links: the vehicles.
        told: hears of a disk that is full.
    """

    def __init__(
        self,
        path: Path,
        sortie: int,
        links: Sequence[VehicleLink],
        told: Callable[[str], None],
    ) -> None:
        self._path, self._sortie, self._links, self._told = path, sortie, links, told
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Keeper:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Keep what came last.

        Raises:
            InputError: it cannot be written.
        """
        self._over.set()
        self._thread.join()
        with Journal(self._path) as journal:
            self._keep(self._stream(journal), None)

    def _stream(self, journal: Journal) -> Stream:
        return Stream(journal, {"file": "live", "quantity": "power", "matched": []})

    def _run(self) -> None:
        failed = False
        with Journal(self._path) as journal:
            stream = self._stream(journal)
            while not self._over.wait(_EVERY_S):
                try:
                    self._keep(stream, _AT_ONCE)
                    failed = False
                except InputError as error:
                    if not failed:
                        self._told(f"readings wait in memory: {error}")
                    failed = True

    def _keep(self, stream: Stream, most: int | None) -> None:
        """Bring what was heard into the journal; only then it is forgotten."""
        for link in self._links:
            heard = link.heard.levels
            some = [heard[k] for k in range(len(heard) if most is None else min(most, len(heard)))]
            if some:
                stream.take_in([self._reading(link.uav, *one) for one in some])
                for _ in some:
                    heard.popleft()

    def _reading(self, uav: int, moment: float, lat: float, lon: float, level: float) -> Reading:
        place = round(lat, 8), round(lon, 8)
        source = f"live, UAV {uav}"
        return Reading(*place, level, None, False, moment, self._sortie, uav, source)
