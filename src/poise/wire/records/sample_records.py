"""An agent's counters, published a few times a second, without field names.

All are totals since the component, connector or process began, so that a lost sample
loses nothing.
"""

from __future__ import annotations

from msgspec import Struct

SAMPLE_EVERY = 0.2
"""How often agents tell what they count, unless asked for another rate [s]."""


class ComponentSample(Struct, frozen=True, array_like=True):
    """A component's counters; `epoch` tells incarnations of one component apart."""

    name: str
    epoch: int
    cpu: float  # CPU time [s]
    # Time in which its thread could run and did not [s]; 0 for components with jobs,
    # which tell better whether it keeps up
    wait: float
    # Releases of timers and messages that came, and that were ended
    asked: int
    done: int


class ConnectorSample(Struct, frozen=True, array_like=True):
    """The counters of one end of a connector."""

    name: str
    calls: int
    messages: int
    # What left this end over a wire, and what came to it
    bytes_out: int
    bytes_in: int
    errors: int
    drops: int
    arrivals: int = 0  # How many came of whom it is known how long they were under way
    # How long those were so, in all, and how far that is off at most [s]
    latency: float = 0.0
    latency_error: float = 0.0


class ContainerSample(Struct, frozen=True, array_like=True):
    """A container's counters."""

    name: str
    pid: int
    at: float  # When they were read [s], on its computer's clock
    cpu: float  # CPU time of the process [s]
    memory: int  # Its proportional set size [bytes]; read less often than the rest
    components: tuple[ComponentSample, ...]
    connectors: tuple[ConnectorSample, ...]


class AgentSample(Struct, frozen=True, array_like=True):
    """A computer's counters."""

    computer: str
    at: float
    cpu: float  # CPU time of the agent itself [s]
    containers: tuple[ContainerSample, ...]
    # CPU time of all programs of the computer, the robot's or not [s]; None: nobody
    # counts it
    busy: float | None = None
