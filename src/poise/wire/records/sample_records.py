"""The counters of an agent, published a few times a second, without field names.

All counters are totals since the component, connector or process began; differences are
for the receiver, so that a lost sample loses nothing.
"""

from __future__ import annotations

from msgspec import Struct

SAMPLE_EVERY = 0.2
"""How often agents tell what they count, unless asked for another rate [s]."""


class ComponentSample(Struct, frozen=True, array_like=True):
    """A component's counters; `epoch` tells incarnations of one component apart.

    Parameters
    ----------
    cpu
        CPU time [s].
    wait
        Time in which its thread could run and did not [s]; 0 for components with
        jobs, which tell better whether it keeps up.
    asked, done
        Releases of timers and messages that came, and that were ended.
    """

    name: str
    epoch: int
    cpu: float
    wait: float
    asked: int
    done: int


class ConnectorSample(Struct, frozen=True, array_like=True):
    """The counters of one end of a connector.

    Parameters
    ----------
    bytes_out, bytes_in
        What left this end over a wire, and what came to it.
    arrivals
        How many came of whom it is known how long they were under way.
    latency, latency_error
        How long those were so, in all, and how far that is off at most [s].
    """

    name: str
    calls: int
    messages: int
    bytes_out: int
    bytes_in: int
    errors: int
    drops: int
    arrivals: int = 0
    latency: float = 0.0
    latency_error: float = 0.0


class ContainerSample(Struct, frozen=True, array_like=True):
    """A container's counters.

    Parameters
    ----------
    at
        When they were read [s], on its computer's clock.
    cpu
        CPU time of the process [s].
    memory
        Its proportional set size [bytes]; read less often than the rest.
    """

    name: str
    pid: int
    at: float
    cpu: float
    memory: int
    components: tuple[ComponentSample, ...]
    connectors: tuple[ConnectorSample, ...]


class AgentSample(Struct, frozen=True, array_like=True):
    """A computer's counters.

    Parameters
    ----------
    cpu
        CPU time of the agent itself [s].
    busy
        CPU time of all programs of the computer, the robot's or not [s]; None: nobody
        counts it.
    """

    computer: str
    at: float
    cpu: float
    containers: tuple[ContainerSample, ...]
    busy: float | None = None
