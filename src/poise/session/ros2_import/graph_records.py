"""What was seen of a running ROS 2 graph, and of each publisher; in SI units."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from statistics import quantiles
from typing import Any, Literal

from msgspec import Struct

_OLDEST = 60.0
"""[s] Stamps that are older, or from the future, are of another clock."""
_LAST = 400
_FEW = 3


class PublisherCount:
    """What came from one publisher.

    Messages have sequence numbers, so the rate counts those of the pauses, too.
    """

    def __init__(self) -> None:
        self.received = 0
        self._bytes = 0
        self._first = self._last = (0, 0)
        self._ages: deque[float] = deque(maxlen=_LAST)
        self.stamps: deque[int] = deque(maxlen=_LAST)

    def count(self, size: int, number: int, sent: int) -> None:
        """Count a message: its size, its number and when it was sent [ns]."""
        self._last = (number, sent)
        self._first = self._first if self.received else self._last
        self.received += 1
        self._bytes += size

    def count_stamp(self, stamp: int, now: int) -> None:
        """Count the stamp of a message that arrived `now` [ns]."""
        self.stamps.append(stamp)
        if 0 <= now - stamp <= _OLDEST * 1e9:
            self._ages.append((now - stamp) / 1e9)

    def flow(self, node: str, seconds: float) -> Flow:
        """Return what was measured in `seconds`."""
        messages = self._last[0] - self._first[0]
        elapsed = (self._last[1] - self._first[1]) / 1e9
        exact = messages >= _FEW and elapsed > 0
        return Flow(
            node=node,
            rate=messages / elapsed if exact else self.received / seconds,
            size=self._bytes / self.received,
            age=self._age(),
            stamps=tuple(self.stamps),
        )

    def _age(self) -> Age | None:
        if len(self._ages) < _FEW:
            return None
        hundredths = quantiles(self._ages, n=100, method="inclusive")
        return Age(hundredths[49], hundredths[98])


def stamp_of(data: bytes) -> int:
    """Return the stamp [ns] with which a serialized message (CDR) begins."""
    order: Literal["little", "big"] = "little" if data[1] & 1 else "big"
    seconds = int.from_bytes(data[4:8], order, signed=True)
    return seconds * 1_000_000_000 + int.from_bytes(data[8:12], order)


CallKind = Literal["service", "action"]


class Age(Struct, frozen=True):
    """How old the stamps of messages were when they arrived [s]."""

    median: float
    p99: float


class Flow(Struct, frozen=True, kw_only=True):
    """What one node publishes on one topic.

    `rate` [Hz] is 0 when nothing came. `stamps` [ns] are the last ones of its messages.
    """

    node: str
    rate: float = 0.0
    size: float = 0.0
    age: Age | None = None
    stamps: tuple[int, ...] = ()


class Topic(Struct, frozen=True, kw_only=True):
    """A topic, its ends by full node name, and what each publisher sends."""

    name: str
    type: str
    flows: tuple[Flow, ...] = ()
    subscribers: tuple[str, ...] = ()
    quality: str = ""
    unmeasured: str = ""


class Call(Struct, frozen=True, kw_only=True):
    """A service or an action, and the nodes that offer and use it."""

    name: str
    type: str
    kind: CallKind
    clients: tuple[str, ...]
    servers: tuple[str, ...]


class NodeProcess(Struct, frozen=True, kw_only=True):
    """A process and the nodes in it."""

    pid: int
    nodes: tuple[str, ...]
    arguments: tuple[str, ...] = ()  # its command line; empty: it could not be read
    folder: str = "/"  # where it was started
    environment: Mapping[str, str] = {}  # what of it matters to ROS 2 and to Python
    cpu: float = 0.0  # mean use [cores], with its child processes
    memory: float = 0.0  # its share of what it holds [bytes], with its child processes
    devices: tuple[str, ...] = ()  # device nodes that it has open


class Hardware(Struct, frozen=True, kw_only=True):
    """A computer: its cores, its memory [bytes], and what others take of them."""

    name: str
    cores: float
    memory: float
    other_cpu: float = 0.0
    other_memory: float = 0.0


class Graph(Struct, frozen=True, kw_only=True):
    """A ROS 2 graph that was observed for `seconds`.

    `elsewhere`: nodes whose process is not on this computer, or is not visible here ->
    why. `own_cpu` is what the observer itself took [cores].
    """

    computer: Hardware
    seconds: float
    processes: tuple[NodeProcess, ...] = ()
    topics: tuple[Topic, ...] = ()
    calls: tuple[Call, ...] = ()
    elsewhere: Mapping[str, str] = {}
    remarks: tuple[str, ...] = ()
    own_cpu: float = 0.0


class Start(Struct, frozen=True, kw_only=True):
    """How a process can be started again: as keys of a component; none: not known."""

    keys: Mapping[str, Any] = {}
    remarks: tuple[str, ...] = ()
