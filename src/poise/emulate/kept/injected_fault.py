"""A fault that was injected into emulated computers, to rehearse it."""

from __future__ import annotations

import time
from typing import Literal

from msgspec import Struct

from poise.emulate.network.plan import Shape

FaultKind = Literal["cut", "slow", "crashed", "frozen", "frozen agent", "load"]


class InjectedFault(Struct, frozen=True, kw_only=True):
    """A fault that any process injected, in force until it is healed.

    Parameters
    ----------
    on
        The computer, or the two computers of a link.
    since
        [s since 1970].
    shape
        Of a slow link.
    cpu
        Of a load [host cores].
    processes
        Of a load: their numbers.
    """

    kind: FaultKind
    on: tuple[str, ...]
    since: float
    shape: Shape | None = None
    cpu: float | None = None
    processes: tuple[int, ...] = ()

    def __str__(self) -> str:
        since = time.strftime("%H:%M:%S", time.localtime(self.since))
        what = f"{self.kind} {' '.join(self.on)}"
        if self.cpu is not None:
            what += f" of {self.cpu:g} cores"
        if self.shape is not None and self.shape.bandwidth is not None:
            what += f" to {self.shape.bandwidth * 8e-6:g} Mbit/s"
        if self.shape is not None and self.shape.latency:
            what += f" with {self.shape.latency * 1e3:g} ms"
        return f"{what} since {since}"
