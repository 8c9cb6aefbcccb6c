"""What was seen of a running ROS 2 graph; in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from msgspec import Struct

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
    """A topic, its ends by full node name, and what each publisher sends.

    `unmeasured`: why nothing was measured; empty when it was.
    """

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
    """A process and the nodes in it.

    Parameters
    ----------
    arguments
        Its command line; empty: it could not be read.
    folder
        Where it was started.
    environment
        What of its environment matters to ROS 2 and to Python.
    cpu
        Mean use [cores], with its child processes.
    memory
        Its share of what it holds [bytes], with its child processes.
    devices
        Device nodes that it has open.
    """

    pid: int
    nodes: tuple[str, ...]
    arguments: tuple[str, ...] = ()
    folder: str = "/"
    environment: Mapping[str, str] = {}
    cpu: float = 0.0
    memory: float = 0.0
    devices: tuple[str, ...] = ()


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
    """How a process can be started again: as keys of a component.

    `keys` is empty when that is not known; `remarks` are for people.
    """

    keys: Mapping[str, Any] = {}
    remarks: tuple[str, ...] = ()
