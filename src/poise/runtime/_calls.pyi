"""What every call inside a container runs; the code is in ``runtime/native``.

All of it relies on the GIL as its only lock: every method is atomic, and those that
wait give the GIL up meanwhile.
"""

from collections.abc import Callable
from typing import Any, NoReturn

from poise.wire.messages import Summary

def begin_chains(first: int) -> None:
    """Let this process's chain numbers go on from `first`; end this thread's chain."""

def new_chain() -> int:
    """Begin a chain on this thread and return its number, unique in the robot."""

def join_chain(chain: int) -> None:
    """Let this thread go on with a chain that began elsewhere; 0 ends it."""

def current_chain() -> int:
    """Return the chain of this thread; a new one when it has none."""

class Turn:
    """The right to run a component's code; shut until it is first opened.

    Those who wait get it in the order in which they came. `what` names the component
    in errors.
    """

    def __init__(self, what: str) -> None: ...
    @property
    def is_retired(self) -> bool:
        """Whether `retire` was called."""

    def enter(self, chain: int, limit: float) -> None:
        """Wait for the turn up to `limit` [s]; each `enter` asks for one `leave`.

        The chain that has the turn enters again at once. Chain 0 is nobody's.

        Raises
        ------
        Timeout
            Another chain had it all the time, or the component is not active.
        Retired
            The component has moved away, before or during the wait.
        """

    def try_enter(self, chain: int) -> bool:
        """Take the turn if it is free, and return whether that is so; never wait."""

    def leave(self) -> None:
        """Give the turn back; RuntimeError when nobody has it."""

    def step_out(self, chain: int) -> int:
        """Let others in while `chain` waits in a call that its component makes.

        Returns
        -------
        What `step_in` needs; -1 when the chain has not the turn, or it is lent: then
        there is nothing to step out of, and no `step_in`.
        """

    def step_in(self, chain: int, depth: int, limit: float) -> None:
        """Wait for the turn again, up to `limit` [s], also when retired.

        Raises
        ------
        Timeout
            Others had it all the time; the chain is still outside.
        """

    def lend(self, chain: int) -> None:
        """Let one chain in while shut: that of a life-cycle hook; 0 ends that."""

    def open(self) -> None:
        """Let chains enter, as the component is active now."""

    def shut(self, limit: float) -> None:
        """Wait up to `limit` [s] until no chain is inside, and let none in.

        While a chain is stepped out, others come in: it may wait for them.

        Raises
        ------
        Timeout
            A chain stayed inside; the turn is as it was.
        Retired
            As for `enter`.
        """

    def retire(self) -> None:
        """Send away everyone who waits, and from now on everyone who comes, for good.

        A chain inside stays, and may enter again.
        """

class Histogram:
    """Counts values >= 0 with quantiles that are right within 5 %.

    Mean and maximum are exact. Values from 2^-30 to 2^64 are told apart; it holds at
    most some 750 numbers, however many values come.
    """

    def __init__(self) -> None: ...
    def add(self, value: float) -> None:
        """Count one value; below zero and NaN count as zero."""

    def summary(self) -> Summary:
        """Return count, mean, median, 99th percentile and maximum."""

class Counts:
    """What one end of a connector counts.

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
    def add_call(
        self,
        seconds: float,
        bytes_out: int = 0,
        bytes_in: int = 0,
        failed: bool = False,
    ) -> None:
        """Count a call at once, whatever other threads count."""

    def add_message(self, bytes_out: int = 0, bytes_in: int = 0) -> None:
        """Count a message at once, whatever other threads count."""

    @property
    def cpu(self) -> float:
        """CPU time of calls into the callee, with all that it called here [s].

        Exact for calls of 10 us and more; in bursts of shorter ones every call that
        begins 10 us after the last measured one is measured, and the others count in
        proportion to their wall time.
        """

    def add_cpu(self, seconds: float) -> None:
        """Count the CPU time of a call that was measured elsewhere."""

class DirectCall:
    """Calls `method` on the caller's thread, under `turn`, and counts that in `counts`.

    Parameters
    ----------
    limit
        Of the wait for the turn, and of the whole call [s].
    translate
        Takes the exception that the method raised, and raises what the caller gets.
    resend
        Is called instead when the turn is retired, with the same arguments; then
        nothing is counted here. None: `poise.runtime.turn.Retired` is raised.

    Raises
    ------
    Timeout
        The turn did not come in time, or the result came later than `limit`; the
        callee itself is not interrupted.
    """

    limit: float

    def __init__(
        self,
        method: Callable[..., Any],
        turn: Turn,
        limit: float,
        counts: Counts,
        translate: Callable[[Exception], NoReturn],
        resend: Callable[..., Any] | None = None,
    ) -> None: ...
    def __call__(self, *args: Any, **kwargs: Any) -> Any: ...
