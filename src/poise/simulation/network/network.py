"""Links between simulated computers: delays, losses, cuts and clogs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from poise.simulation._engine import Stream
from poise.simulation.network.links import LinkModel, set_links
from poise.simulation.schedule.choices import Choices
from poise.simulation.schedule.scheduler import Scheduler

_TWICE = 0.05
"""While datagrams are lost, so many others come twice."""


class Network:
    """The links between all computers; each direction breaks by itself.

    The engine has them, for most that goes over them is its own.

    `links`: pairs of computers -> their links; the others have links like `model`.
    `model`: of links that are not named.
    `loss`: the share of datagrams that do not come: a fault.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        choices: Choices,
        model: LinkModel | None = None,
        links: Mapping[frozenset[str], LinkModel] = {},
    ) -> None:
        self.scheduler = scheduler
        self.choices = choices
        self.model = model or LinkModel()
        self.loss = 0.0
        self._num_cuts = 0
        engine = self._engine = scheduler.engine
        set_links(engine, links, self.model)

    def is_cut(self, source: str, target: str) -> bool:
        """Return whether nothing gets from one computer to another."""
        return self._num_cuts > 0 and self._engine.is_cut(source, target)

    def cut(self, source: str, target: str) -> None:
        """Let nothing through in one direction; each cut is healed by itself."""
        self._num_cuts += 1
        self._engine.cut(source, target)

    def heal(self, source: str, target: str) -> None:
        """End a cut; when it was the last one, streams go on."""
        self._num_cuts -= 1
        self._engine.heal(source, target)

    def clog(self, source: str, target: str, seconds: float) -> None:
        """Let what is sent from now on arrive after `seconds` [s] at the soonest."""
        self._engine.clog(source, target, seconds)

    def time_for(self, source: str, target: str, size: float) -> float:
        """Return how long so much takes over an idle link [s]."""
        return self._engine.time_for(source, target, size)

    def stream(self, source: str, target: str) -> Stream:
        """Return a new stream in one direction: in order, none lost.

        What is sent over a cut link waits for its end, as TCP lets it.
        """
        return self._engine.stream(source, target)

    def arrivals(self, source: str, target: str, size: int) -> Sequence[float]:
        """Return when a datagram arrives [s]: once, twice or never, in any order."""
        engine, happens = self._engine, self.choices.happens
        at = engine.arrival(source, target, size)
        if source == target:
            return (at,)
        if self.is_cut(source, target):
            return ()
        if self.loss and happens("network", self.loss):
            return ()
        if self.loss and happens("network", _TWICE):
            return at, engine.arrival(source, target, size)
        return (at,)
