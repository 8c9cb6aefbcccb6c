"""What every call inside a container runs; the code is in ``runtime/native``.

All of it relies on the GIL as its only lock: every method is atomic, and those that
wait give the GIL up meanwhile.
"""

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from poise.wire.codec import Bytes
from poise.wire.frame import Frame
from poise.wire.records.deployment import Summary

def begin_chains(first: int) -> None:
    """Let this process's chain numbers go on from `first`; end this thread's chain."""

def new_chain() -> int:
    """Begin a chain on this thread and return its number, unique in the robot."""

def join_chain(chain: int) -> None:
    """Let this thread go on with a chain that began elsewhere; 0 ends it."""

def current_chain() -> int:
    """Return the chain of this thread; a new one when it has none."""

def time_left(limit: float) -> float:
    """Return what a call may take that begins now, with a limit of its own [s].

    0 or less: the call that it is made in is over.
    """

def deadline() -> int:
    """Return until when somebody waits for this thread: monotonic clock [ns].

    The largest number of 64 bits when nobody does.
    """

def set_deadline(moment: int) -> None:
    """Let somebody wait for this thread until then."""

class Exclusion:
    """Mutual exclusion of call chains in a component; paused until first resumed.

    It is ROS 2's mutually exclusive callback group, with re-entrance: the chain that is
    inside may enter again. Chains that wait enter in the order in which they came.
    `what` names the component in errors.
    """

    def __init__(self, what: str) -> None: ...
    @property
    def is_redirected(self) -> bool:
        """Whether `redirect` was called."""

    def enter(self, chain: int, limit: float) -> None:
        """Wait up to `limit` [s] to enter; each `enter` needs one `leave`.

        The chain that is inside enters again at once. Chain 0 is nobody's.

        Raises
        ------
        Timeout
            Another chain was inside all the time, or the component is not active.
        Redirected
            The component has moved, before or during the wait.
        """

    def leave(self) -> None:
        """Undo one `enter`; RuntimeError when nobody is inside."""

    def step_out(self, chain: int) -> int:
        """Let others in while `chain` waits in a call that its component makes.

        Returns
        -------
        What `step_in` needs; -1 when the chain is not inside, or the exclusion is lent:
        then there is nothing to step out of, and no `step_in`.
        """

    def step_in(self, chain: int, depth: int, limit: float) -> None:
        """Wait up to `limit` [s] to be inside again, also when redirected.

        Raises
        ------
        Timeout
            Others were inside all the time; the chain is still outside.
        """

    def lend(self, chain: int) -> None:
        """Let one chain in while paused: that of a life-cycle hook; 0 ends that."""

    def resume(self) -> None:
        """Let chains enter: the component is active."""

    def pause(self, limit: float) -> None:
        """Wait up to `limit` [s] until no chain is inside, and let none in.

        While a chain is stepped out, others may enter: it may wait for them.

        Raises
        ------
        Timeout
            A chain stayed inside; nothing has changed.
        Redirected
            As for `enter`.
        """

    def redirect(self) -> None:
        """Refuse all chains that wait and all that come, for good.

        The chain that is inside stays, and may enter again.
        """

class Histogram:
    """Counts values >= 0 with quantiles that are right within 5 %.

    Mean and maximum are exact. Values from 2^-30 to 2^64 are distinguished; it holds
    at most some 750 numbers, however many values come.
    """

    def __init__(self) -> None: ...
    def add(self, value: float) -> None:
        """Count one value; below zero and NaN count as zero."""

    def summary(self) -> Summary:
        """Return count, mean, median, 99th percentile and maximum."""

class StatsPage:
    """The container's end of its stats page, for `stats_page.StatsPage`.

    Parameters
    ----------
    descriptor
        From `stats_page.new_memory`; not needed any more when this returns.
    """

    def __init__(self, descriptor: int) -> None: ...
    def beat(self) -> None:
        """Increment the heartbeat, which shows the agent that this thread runs."""

RECORD_SIZE: int
"""What one record of a stats page takes [bytes]."""

class PageSampler:
    """The agent's end of a container's stats page.

    Parameters
    ----------
    process
        The container's.
    proc
        Where the kernel's files about processes are.
    """

    def __init__(self, descriptor: int, process: int, proc: str = "/proc") -> None: ...
    def read(
        self,
    ) -> (
        tuple[
            float,
            float,
            list[tuple[str, int, float, float, int, int]],
            list[tuple[str, int, int, int, int, int, int, int, float, float]],
        ]
        | None
    ):
        """Return what was used and done until now; None when nothing is there.

        Returns
        -------
        Moment [s] and CPU time of the process and its commands [s], then the fields of
        a `ComponentSample` for each component and of a `ConnectorSample` for each end
        of a connector. A component's CPU time is that of its thread, plus what calls
        into it used, less what calls out of it used on its thread. Of a thread that
        runs at the moment, up to a tick of the kernel (1 to 10 ms) is not in yet.
        Waits are those of components without jobs.
        """

    def heartbeat(self) -> int:
        """Return how often the container's control thread has run."""

    def commands(self) -> list[int]:
        """Return the processes of the command-line components."""

class ComponentCounters:
    """What a component used and did, in a stats page or not."""

    def __init__(self) -> None: ...
    def begin(self) -> None:
        """Count the CPU time of this thread from now on."""

    def watch(self, process: int) -> None:
        """Count the CPU time of a process from now on; its children's is not in."""

    def end(self) -> None:
        """Count no more: this thread, or the process, ends.

        A thread's time so far stays, a process's is forgotten.
        """

    def note_idle(self) -> None:
        """Say that this thread begins to wait for work: nobody asks the kernel then."""

    def note_busy(self) -> None:
        """Say that this thread has work again."""

    def note_asked(self) -> None:
        """Count a message or one-way call that came."""

    def note_done(self) -> None:
        """Count a job that was ended."""

    def plan(self, timers: Sequence[tuple[float, float]]) -> None:
        """Let timers ask for jobs at start + k * period, k = 1, 2, ... [s], no others.

        What the timers before asked for stays.
        """

    def cpu(self) -> float:
        """Return the CPU time so far, without calls [s]."""

    def enter(self, page: StatsPage, name: str, epoch: int) -> bool:
        """Go on counting in a stats page; False when it is full.

        A name of over 255 bytes is cut.
        """

    def leave(self) -> None:
        """Go on counting outside; harmless when it is in no stats page."""

class Counts:
    """What one end of a connector counts, in a stats page or not.

    Parameters
    ----------
    bytes_out, bytes_in
        Of what left this end over a wire, and of what came to it, without the
        transport's own [bytes].
    delay
        Of calls [s]: where they begin, there and back; where they end, until the
        answer.
    wait
        Of messages [s]: where they begin, until they went out; where they end, from
        their arrival until the component took them.
    size
        Of what went over a wire, calls both ways [bytes].
    latency
        Of what came over a wire: since it was sent [s].
    latency_error
        How far those are off at most, in the mean [s].
    """

    calls: int
    messages: int
    bytes_out: int
    bytes_in: int
    errors: int
    drops: int

    def __init__(self) -> None: ...
    @property
    def delay(self) -> Histogram: ...
    @property
    def wait(self) -> Histogram: ...
    @property
    def size(self) -> Histogram: ...
    @property
    def latency(self) -> Histogram: ...
    @property
    def latency_error(self) -> float: ...
    def add_call(
        self,
        seconds: float,
        bytes_out: int = 0,
        bytes_in: int = 0,
        latency: float = ...,
        error: float = 0.0,
        failed: bool = False,
    ) -> None:
        """Count a call at once, whatever other threads count.

        `latency` is no number while nobody knows it.
        """

    def add_message(
        self,
        bytes_out: int = 0,
        bytes_in: int = 0,
        latency: float = ...,
        error: float = 0.0,
    ) -> None:
        """Count a message at once, as `add_call` does."""

    @property
    def cpu(self) -> float:
        """CPU time of calls into the callee, with all that it called here [s].

        Exact for calls of 10 us and more; in bursts of shorter ones every call that
        begins 10 us after the last measured one is measured, and the others count in
        proportion to their wall time. Of calls from other containers one in 1 ms is
        measured, and all that follow a measured one of 50 us or more.
        """

    def add_cpu(self, seconds: float) -> None:
        """Count the CPU time of a call that was measured elsewhere."""

    def enter(self, page: StatsPage, name: str) -> bool:
        """Go on counting in a stats page, as `ComponentCounters.enter`."""

    def attribute(
        self, source: ComponentCounters | None, target: ComponentCounters | None
    ) -> None:
        """Say between whose counters, in the same page, the CPU time of calls moves.

        None: that end is in another container.
        """

    def leave(self) -> None:
        """Go on counting outside; harmless when it is in no stats page."""

class DirectCall:
    """Calls `method` on the caller's thread, under `exclusion`, and counts it.

    Parameters
    ----------
    limit
        Of the wait to enter, and of the whole call [s]; less in a call of which
        less is left.
    translate
        Takes the exception that the method raised, and raises what the caller gets.
    resend
        Is called instead when the component has moved, with the same arguments; then
        nothing is counted here. None: `Redirected` is raised.

    Raises
    ------
    Timeout
        The component was busy, or the result came later than `limit`; the
        callee itself is not interrupted.
    """

    limit: float

    def __init__(
        self,
        method: Callable[..., Any],
        exclusion: Exclusion,
        limit: float,
        counts: Counts,
        translate: Callable[[Exception | SystemExit], NoReturn],
        resend: Callable[..., Any] | None = None,
    ) -> None: ...
    def __call__(self, *args: Any, **kwargs: Any) -> Any: ...

class ServedCall:
    """Answers the calls of one method from other containers.

    It runs `method` under `exclusion`, on the thread that received the call, and counts
    the CPU time in `counts`. A call chain runs on one thread of a process at a time: a
    call back enters when the chain's first thread waits in `call_remote`.

    Parameters
    ----------
    decode
        Turns a frame's body and buffers into the tuple of arguments.
    encode
        Turns a result into an answer, under the exclusion: the result may be state.
    limit
        Of the wait for chain and exclusion [s]; less when the caller waits for less.
    translate
        As `DirectCall`'s.
    is_over
        Returns whether the caller is gone. Then a call that had to wait is not run.

    Calling it takes a frame, and how far the caller's clock is ahead at most [s]; NaN
    when nobody knows. Then the time on the wire does not count.

    Raises
    ------
    Timeout
        The caller's limit has passed, another thread ran the chain or another chain
        was inside all the time, or the caller is gone. The method was not called.
    Redirected
        The component has moved away; its method was not called.
    WireError
        What `decode` raised.
    """

    def __init__(
        self,
        decode: Callable[[Bytes, memoryview], tuple[Any, ...]],
        method: Callable[..., Any],
        encode: Callable[[Any], list[Bytes]],
        exclusion: Exclusion,
        limit: float,
        counts: Counts,
        translate: Callable[[Exception | SystemExit], NoReturn],
        is_over: Callable[[], bool],
    ) -> None: ...
    def __call__(self, frame: Frame, ahead: float = 0.0) -> list[Bytes]: ...

def call_remote(
    chain: int,
    limit: float,
    what: str,
    request: Callable[[list[Bytes], float], Frame],
    pieces: list[Bytes],
) -> Frame:
    """Return ``request(pieces, limit)``; meanwhile the chain may be called back.

    Parameters
    ----------
    what
        The connector of the call, for errors.

    Raises
    ------
    Timeout
        A call back still ran `limit` [s] after the call was over; it runs on.
    """
