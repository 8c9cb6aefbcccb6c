"""What was measured of components and connectors, as records; and the file for it.

A profile belongs to one robot, one kind of computer and one version of the code. All
CPU is in cores of the reference computer.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.estimate.profile.spread import Spread


class TimerProfile(Struct, frozen=True, kw_only=True):
    """A timer's execution time [s], and the share of releases that were missed."""

    period: float
    median: float
    p99: float
    maximum: float
    missed: float = 0.0


class ComponentProfile(Struct, frozen=True, kw_only=True):
    """What one component needed when its architecture ran alone.

    Parameters
    ----------
    version
        Fingerprint of its implementation and parameters (`version_of`).
    cpu
        Its own CPU [cores].
    share
        Its part of what its container used beyond its components: transports, status,
        the interpreter's own threads; in equal parts [cores].
    memory
        What it added to a container's memory, at most [bytes].
    base
        Its part of an empty container's memory, in equal parts [bytes].
    state
        Size of its snapshot [bytes].
    start
        From the wish to start its container until it was ready [s].
    repeat
        How far the means of repeated measurements lay apart [cores].
    stable
        Whether repeated measurements agree.
    """

    version: str
    cpu: Spread
    share: float = 0.0
    memory: float = 0.0
    base: float = 0.0
    state: float = 0.0
    start: float = 0.0
    timers: Mapping[str, TimerProfile] = {}
    repeat: float = 0.0
    stable: bool = True


class ConnectorProfile(Struct, frozen=True, kw_only=True):
    """What went over a connector.

    Parameters
    ----------
    calls, messages
        Per second [1/s].
    size
        Mean size of a call, both ways, or of a message, when encoded [bytes].
    median, p99, largest
        Of these sizes; 0 where they were not counted [bytes].
    """

    calls: float = 0.0
    messages: float = 0.0
    size: float = 0.0
    median: float = 0.0
    p99: float = 0.0
    largest: float = 0.0

    @property
    def rate(self) -> float:
        """Calls and messages per second [1/s]."""
        return self.calls + self.messages

    @property
    def traffic(self) -> float:
        """What it sends when its ends are apart [bytes/s]."""
        return self.rate * self.size


class Costs(Struct, frozen=True, kw_only=True):
    """What one end of a connector costs its computer.

    `call` and `message` in CPU time each [s], `byte` in CPU time per byte [s/byte].
    """

    call: float = 0.0
    message: float = 0.0
    byte: float = 0.0

    def load(self, connector: ConnectorProfile) -> float:
        """Return what this end uses for what goes over the connector [cores]."""
        return (
            self.call * connector.calls
            + self.message * connector.messages
            + self.byte * connector.traffic
        )


class KindCosts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What connectors of one kind cost, at the source's end and at the target's.

    Both ends of a direct one are in one process: all counts for its source.
    """

    source: Costs = Costs()
    target: Costs = Costs()

    def load(self, connector: ConnectorProfile) -> float:
        """Return what both ends use together [cores]."""
        return self.source.load(connector) + self.target.load(connector)


class Profile(Struct, frozen=True, kw_only=True):
    """All that was measured of a robot's software on one kind of computer.

    Parameters
    ----------
    poise
        The version of Poise.
    computer
        The computer on which it was measured, and its `speed`.
    seconds
        How long each architecture was measured each time [s].
    agent
        CPU of an agent [cores of the reference computer].
    costs
        ``direct``, ``local`` and ``remote`` -> what such connectors cost, as `poise
        calibrate` measured it; empty: it did not.
    """

    robot: str
    poise: str
    computer: str
    speed: float
    at: str
    seconds: float
    agent: float = 0.0
    components: Mapping[str, ComponentProfile] = {}
    connectors: Mapping[str, ConnectorProfile] = {}
    costs: Mapping[str, KindCosts] = {}
