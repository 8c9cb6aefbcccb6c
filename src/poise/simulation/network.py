"""Links between simulated computers (delays, losses, cuts, clogs), and datagrams."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from math import inf
from operator import itemgetter

import msgspec

from poise.decoding import msgpack_decoder
from poise.simulation.link_models import LinkModel, set_links
from poise.simulation.robot.simulated_process import Process
from poise.simulation.scheduler import Scheduler, SimulatedTask
from poise.wire.heartbeats import Address, Received
from poise.wire.records.heartbeat_records import MANAGER, Heartbeat

_TWICE = 0.05
"""While datagrams are lost, so many others come twice."""


class Network:
    """The links between all computers; each direction breaks by itself.

    The engine has them, for most that goes over them is its own.

    `links`: pairs of computers -> their links; the others have links like `model`.
    `loss`: the share of datagrams that do not come: a fault.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        links: Mapping[frozenset[str], LinkModel] = {},
        model: LinkModel = LinkModel(),  # noqa: B008, it is frozen
    ) -> None:
        self.scheduler, self.choices = scheduler, scheduler.choices
        self.engine, self.model = scheduler.engine, model
        self.loss = 0.0
        self._num_cuts = 0
        set_links(self.engine, links, model)

    def is_cut(self, source: str, target: str) -> bool:
        """Return whether nothing gets from one computer to another."""
        return self._num_cuts > 0 and self.engine.is_cut(source, target)

    def cut(self, source: str, target: str) -> None:
        """Let nothing through in one direction; each cut is healed by itself."""
        self._num_cuts += 1
        self.engine.cut(source, target)

    def heal(self, source: str, target: str) -> None:
        """End a cut; when it was the last one, streams go on."""
        self._num_cuts -= 1
        self.engine.heal(source, target)

    def arrivals(self, source: str, target: str, size: int) -> Sequence[float]:
        """Return when a datagram arrives [s]: once, twice or never, in any order."""
        engine, happens = self.engine, self.choices.happens
        at = engine.arrival(source, target, size)
        if source == target:
            return (at,)
        if self._num_cuts and engine.is_cut(source, target):
            return ()
        if self.loss and happens("network", self.loss):
            return ()
        if self.loss and happens("network", _TWICE):
            return at, engine.arrival(source, target, size)
        return (at,)


_FIRST_FREE = 32768


class Addresses:
    """The IP addresses of a robot's computers, and who receives datagrams where.

    `hosts`: IP address -> computer.
    `bound`: returns what receives at an address; None: nothing does.
    """

    def __init__(self) -> None:
        self.hosts: dict[str, str] = {}
        self._bound: dict[Address, SimulatedDatagrams] = {}
        self.bound = self._bound.get
        self._free = _FIRST_FREE

    def add(self, computer: str) -> str:
        """Return the IP address of a new computer."""
        host = f"10.0.{len(self.hosts) // 250}.{len(self.hosts) % 250 + 1}"
        self.hosts[host] = computer
        return host

    def host_of(self, computer: str) -> str:
        """Return a computer's IP address."""
        return next(host for host, name in self.hosts.items() if name == computer)

    def bind(self, to: SimulatedDatagrams, host: str, port: int | None) -> Address:
        """Let something receive at a port; None: at a free one."""
        self._free += port is None
        address = host, port or self._free
        self._bound[address] = to
        return address

    def release(self, address: Address, bound: SimulatedDatagrams) -> None:
        """Let it receive there no more."""
        if self._bound.get(address) is bound:
            del self._bound[address]


_MOST = 256
"""So many datagrams that nobody has read are kept; further ones are lost."""


class SimulatedDatagrams:
    """The datagrams of a process, as of a UDP socket.

    The reader is woken by what it may have to answer. All else it gets when its next
    heartbeat is due, with the moment when it came: that spares a switch for each.

    `port`: where it listens; None: at a free one.
    """

    def __init__(
        self,
        addresses: Addresses,
        network: Network,
        process: Process,
        port: int | None = None,
    ) -> None:
        self._addresses = addresses
        self._network = network
        self._process = process
        self._waiting: list[tuple[float, int, Heartbeat, Address]] = []
        self._reads_since = inf
        self._reader: SimulatedTask | None = None
        self._is_urgent = False
        self.computer = process.computer.name
        host = addresses.host_of(self.computer)
        self._address = addresses.bind(self, host, port)
        self._decode = msgpack_decoder(Heartbeat).decode
        process.on_end.append(self.close)

    def receive(self, until: float) -> Sequence[Received]:
        """Return what has come, after a wait until a moment at the most [s]."""
        scheduler, computer = self._process.scheduler, self._process.computer
        self._reads_since = min(self._reads_since, scheduler.now)
        left = until - computer.monotonic()
        if left > 0 and not self._is_urgent:
            self._reader = scheduler.current
            scheduler.wait(left, "heartbeats")
            self._reader = None
        self._is_urgent = False
        now, waiting = scheduler.now, self._waiting
        # while the process stood still nobody read what came
        ago = now - max(self._reads_since, self._process.awake_since)
        own_now = computer.monotonic()
        waiting.sort()  # by moment, and by number: no two have the same
        come = bisect_right(waiting, now, key=itemgetter(0))
        received = [
            (beat, source, own_now - min(now - at, ago))
            for at, _, beat, source in waiting[:come]
        ]
        del waiting[:come]
        return received

    def send(self, beat: Heartbeat, targets: Iterable[Address]) -> None:
        """Send a heartbeat, encoded and decoded once for all who receive it."""
        data = msgspec.msgpack.encode(beat)
        beat, size = self._decode(data), len(data)
        wakes = bool(
            beat.sender == MANAGER or beat.asks or beat.is_cut_off or beat.revoked
        )
        here, source, bound = self.computer, self._address, self._addresses.bound
        arrivals = self._network.arrivals
        for address in targets:
            if (target := bound(address)) is not None:
                for at in arrivals(here, target.computer, size):
                    target.arrive(at, beat, source, wakes=wakes)

    def arrive(
        self, at: float, beat: Heartbeat, source: Address, *, wakes: bool
    ) -> None:
        """Keep what arrives at a moment [s]; wake the reader for it, or not."""
        if len(self._waiting) < _MOST:
            scheduler = self._process.scheduler
            self._waiting.append((at, scheduler.number(), beat, source))
            if wakes:
                scheduler.at(at, self._wake)

    def close(self) -> None:
        """Receive no more."""
        self._addresses.release(self._address, self)

    def _wake(self) -> None:
        self._is_urgent = True
        if self._reader is not None:
            self._process.scheduler.wake(self._reader)
