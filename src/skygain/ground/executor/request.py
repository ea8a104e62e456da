"""The option that takes long work to other machines."""

from __future__ import annotations

__all__ = ["ClusterRequest"]

from dataclasses import dataclass

from skygain.ground.declared import Request, named
from skygain.ground.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ClusterRequest(Request):
    """Many machines"""

    cluster: str | None = named(None, stored=False)
    """tcp://HOST:PORT of a Dask scheduler whose workers compute, or slurm:CONFIG.toml for jobs of
    Slurm; this machine's processes when left out"""

    def check(self) -> None:
        """The address can be one."""
        if self.cluster is None:
            return
        kind, _, rest = self.cluster.partition(":")
        host, _, port = rest.removeprefix("//").rpartition(":")
        known = (kind in ("tcp", "tls") and host and port.isdigit()) or (kind == "slurm" and rest)
        if not known:
            raise InputError(
                "`cluster` must be tcp://HOST:PORT of a Dask scheduler, or slurm:CONFIG.toml, got "
                f"{self.cluster!r}"
            )
