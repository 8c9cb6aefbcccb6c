"""What a simulated robot did: the record that users get."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from poise.manage.tasks.task_reports import TaskReport


class SimulatedLoad(Struct, frozen=True, kw_only=True):
    """How busy a computer was.

    Parameters
    ----------
    capacity, memory_capacity
        What it has [cores, bytes]; None: not stated.
    cpu, peak
        Mean share of its capacity, and the largest of single seconds, in [0, 1].
    memory
        The most that its components needed at once [bytes].
    over_time
        Moments [s], and the mean share of its CPU since the one before.
    """

    computer: str
    capacity: float | None
    cpu: float
    peak: float
    memory: float
    memory_capacity: float | None
    over_time: tuple[tuple[float, float], ...] = ()


class TimerMisses(Struct, frozen=True, kw_only=True):
    """How a timer kept its rate.

    Parameters
    ----------
    period, deadline
        [s]; a timer without a deadline misses none.
    due, missed
        How often it was due, and how often of these it ended late or never began.
    """

    component: str
    timer: str
    period: float
    deadline: float | None
    due: int
    missed: int

    @property
    def share(self) -> float:
        """The share that was missed, in [0, 1]."""
        return self.missed / self.due if self.due else 0.0


class SimulatedChain(Struct, frozen=True, kw_only=True):
    """How old the data at the end of a chain was [s].

    Parameters
    ----------
    uses, missed
        How often it was used, and how often of these it was older than the deadline.
    """

    name: str
    deadline: float | None
    uses: int
    missed: int
    median: float
    p99: float
    maximum: float


class SimulatedMove(Struct, frozen=True, kw_only=True):
    """A component that was moved or restarted elsewhere.

    Parameters
    ----------
    at
        When it began [s].
    before, after
        Computers.
    kind
        ``move``: with its state; ``restart``: after a loss.
    downtime
        For how long it did not work [s].
    why
        As the journal says.
    """

    at: float
    component: str
    before: str
    after: str
    kind: str
    downtime: float
    why: str = ""


class Outage(Struct, frozen=True, kw_only=True):
    """A function of which a component did not work.

    Parameters
    ----------
    at, lasts
        When it began, and how long it took [s].
    components
        Those that did not work.
    over
        Whether it was over when the simulation ended.
    """

    at: float
    function: str
    components: tuple[str, ...]
    lasts: float
    over: bool = True


class SimulatedEvent(Struct, frozen=True, kw_only=True):
    """Something that was injected, or that a manager journalled.

    Parameters
    ----------
    who
        ``fault``, or the manager that wrote it.
    """

    at: float
    who: str
    kind: str
    what: str


class SimulationReport(Struct, frozen=True, kw_only=True):
    """What came of a simulation.

    Parameters
    ----------
    placement
        Component -> computer, at the beginning.
    method
        What decided it, as `poise.place` takes it.
    adapts
        Whether Poise changed the placement by itself.
    asked, seconds
        How long it was to last, and did, from the moment when the robot was up
        [virtual s]; less when it was interrupted.
    took
        CPU time of this process [s].
    messages, dropped
        How many messages were processed, and how many had to make room.
    calls, failed_calls
        How many calls were answered, and how many were not.
    tasks
        How the tasks went; empty: their manager was not up in the end.
    guesses
        What the model had to assume, because neither profile nor robot file says it.
    violations
        Promises of Poise that did not hold: defects of Poise.
    """

    robot: str
    task: str
    method: str
    seed: int
    adapts: bool
    placement: Mapping[str, str]
    asked: float
    seconds: float
    took: float
    loads: tuple[SimulatedLoad, ...]
    timers: tuple[TimerMisses, ...]
    chains: tuple[SimulatedChain, ...]
    moves: tuple[SimulatedMove, ...]
    outages: tuple[Outage, ...]
    events: tuple[SimulatedEvent, ...]
    messages: int
    dropped: int
    calls: int
    failed_calls: int
    tasks: tuple[TaskReport, ...] = ()
    guesses: tuple[str, ...] = ()
    violations: tuple[str, ...] = ()

    @property
    def ratio(self) -> float:
        """How much quicker than real time it was."""
        return self.seconds / self.took if self.took else 0.0

    @property
    def due(self) -> int:
        """How often timers with a deadline were due."""
        return sum(timer.due for timer in self.timers if timer.deadline is not None)

    @property
    def missed(self) -> int:
        """How many of these deadlines were missed."""
        return sum(timer.missed for timer in self.timers if timer.deadline is not None)
