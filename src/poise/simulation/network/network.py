"""Links between simulated computers: delays, losses, cuts and clogs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping

from msgspec import Struct

from poise.simulation.schedule.choices import Choices
from poise.simulation.schedule.scheduler import Scheduler

_LOCAL = 40e-6
"""Between two processes of one computer [s]."""
_BACK_OFF = 1.5
"""After a cut, TCP sends again within this time, or the length of the cut [s]."""


class LinkModel(Struct, frozen=True, kw_only=True):
    """How a link behaves while nothing is wrong with it.

    Parameters
    ----------
    latency, jitter
        One way [s]; jitter is the mean of what comes on top, exponentially.
    bandwidth
        [bytes/s]
    loss, duplication
        Shares of datagrams, in [0, 1].
    """

    latency: float = 200e-6
    jitter: float = 50e-6
    bandwidth: float = 12.5e6
    loss: float = 0.0
    duplication: float = 0.0


class Network:
    """The links between all computers; each direction breaks by itself.

    Parameters
    ----------
    links
        Pairs of computers -> their links; the others have links like `model`.

    Attributes
    ----------
    model
        Of links that are not named.
    loss
        Of datagrams, in addition to the model's: a fault.
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
        self._links = {way: each for pair, each in links.items() for way in _ways(pair)}
        self._free_at: dict[tuple[str, str], float] = {}
        self.loss = 0.0
        self._expovariate = choices.random("jitter").expovariate
        self._cuts: dict[tuple[str, str], list[float]] = {}
        self._clogs: dict[tuple[str, str], float] = {}
        self._streams: list[Stream] = []

    def is_cut(self, source: str, target: str) -> bool:
        """Return whether nothing gets from one computer to another."""
        return bool(self._cuts.get((source, target)))

    def cut(self, source: str, target: str) -> None:
        """Let nothing through in one direction; each cut is healed by itself."""
        self._cuts.setdefault((source, target), []).append(self.scheduler.now)

    def heal(self, source: str, target: str) -> None:
        """End a cut; when it was the last one, streams go on."""
        cuts = self._cuts.get((source, target))
        if not cuts:
            return
        since = cuts.pop(0)
        if not cuts:
            lasted = self.scheduler.now - since
            for stream in self._streams:
                if stream.ends == (source, target):
                    stream.go_on(min(lasted, _BACK_OFF))

    def clog(self, source: str, target: str, seconds: float) -> None:
        """Let what is sent from now on arrive after `seconds` [s] at the soonest."""
        until = self.scheduler.now + seconds
        key = source, target
        self._clogs[key] = max(until, self._clogs.get(key, 0.0))

    def arrival(self, source: str, target: str, size: float) -> float:
        """Return when something that is sent now arrives [s], without a cut."""
        now, way = self.scheduler.now, (source, target)
        if source == target:
            return now + _LOCAL
        link = self._links.get(way, self.model)
        begin = max(now, self._clogs.get(way, 0.0), self._free_at.get(way, 0.0))
        # one after the other: what is sent meanwhile waits
        sent = self._free_at[way] = begin + size / link.bandwidth
        return sent + link.latency + link.jitter * self._expovariate(1.0)

    def time_for(self, source: str, target: str, size: float) -> float:
        """Return how long so much takes over an idle link [s]."""
        if source == target:
            return _LOCAL
        link = self._links.get((source, target), self.model)
        return link.latency + size / link.bandwidth

    def send_datagram(
        self, source: str, target: str, size: int, deliver: Callable[[], object]
    ) -> None:
        """Deliver a datagram once, twice, or never, in any order."""
        if source != target and not self._gets_through(source, target):
            return
        copies = 1
        if self.model.duplication:
            copies += self.choices.happens("network", self.model.duplication)
        for _ in range(copies):
            arrival = self.arrival(source, target, size)
            self.scheduler.at(arrival, lambda: self._arrive(source, target, deliver))

    def stream(self, source: str, target: str) -> Stream:
        """Return a new stream in one direction."""
        stream = Stream(self, source, target)
        self._streams.append(stream)
        return stream

    def forget(self, stream: Stream) -> None:
        """Let a stream that has ended be gone."""
        if stream in self._streams:
            self._streams.remove(stream)

    def _gets_through(self, source: str, target: str) -> bool:
        loss = self.model.loss + self.loss
        if self.is_cut(source, target):
            return False
        return not loss or not self.choices.happens("network", loss)

    def _arrive(self, source: str, target: str, deliver: Callable[[], object]) -> None:
        if not self.is_cut(source, target):
            deliver()


class Stream:
    """One direction of a connection: in order, none lost, until it is closed.

    What is sent over a cut link waits for its end, as TCP lets it.
    """

    def __init__(self, network: Network, source: str, target: str) -> None:
        self.ends = source, target
        self.is_closed = False
        self._network = network
        self._last = 0.0
        self._held: deque[tuple[float, Callable[[], object]]] = deque()

    def send(self, size: float, deliver: Callable[[], object]) -> None:
        """Deliver after all that was sent before."""
        if self.is_closed:
            return
        if self._held or self._network.is_cut(*self.ends):
            self._held.append((size, deliver))
            return
        arrival = max(self._network.arrival(*self.ends, size), self._last)
        self._last = arrival
        self._network.scheduler.at(arrival, lambda: self._arrive(deliver))

    def go_on(self, pause: float) -> None:
        """Send what waited for the end of a cut, after a pause of up to `pause` [s]."""
        network = self._network
        pause = network.choices.between("network", 0.0, pause)
        network.scheduler.at(network.scheduler.now + pause, self._send_held)

    def close(self) -> None:
        """Deliver nothing more."""
        self.is_closed = True
        self._held.clear()
        self._network.forget(self)

    def _send_held(self) -> None:
        if self._network.is_cut(*self.ends):
            return
        held, self._held = self._held, deque()
        for size, deliver in held:
            self.send(size, deliver)

    def _arrive(self, deliver: Callable[[], object]) -> None:
        if not self.is_closed:
            deliver()


def _ways(pair: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Yield both directions of a link."""
    one, other = sorted(pair)
    yield one, other
    yield other, one
