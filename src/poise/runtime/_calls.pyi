"""What every call inside a container runs; explained in ``runtime/native/*.h``.

All of it relies on the GIL as its only lock: every method is atomic, and those that
wait give the GIL up meanwhile.
"""

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from poise.wire.codec import Bytes
from poise.wire.frame import Frame
from poise.wire.records.deployment import Summary

def begin_chains(first: int) -> None: ...
def new_chain() -> int: ...
def join_chain(chain: int) -> None: ...
def current_chain() -> int: ...
def time_left(limit: float) -> float: ...
def deadline() -> int: ...
def set_deadline(moment: int) -> None: ...

class Exclusion:
    """Mutual exclusion of call chains in a component; paused until first resumed.

    It is ROS 2's mutually exclusive callback group, with re-entrance: the chain that is
    inside may enter again. Chains that wait enter in the order in which they came.
    `what` names the component in errors.
    """

    def __init__(self, what: str) -> None: ...
    @property
    def is_redirected(self) -> bool: ...
    def enter(self, chain: int, limit: float) -> None: ...
    def leave(self) -> None: ...
    def step_out(self, chain: int) -> int: ...
    def step_in(self, chain: int, depth: int, limit: float) -> None: ...
    def lend(self, chain: int) -> None: ...
    def resume(self) -> None: ...
    def pause(self, limit: float) -> None: ...
    def redirect(self) -> None: ...

class Histogram:
    """Counts values >= 0 with quantiles that are right within 5 %.

    Mean and maximum are exact. Values from 2^-30 to 2^64 are distinguished; it holds
    at most some 750 numbers, however many values come.
    """

    def __init__(self) -> None: ...
    def add(self, value: float) -> None: ...
    def summary(self) -> Summary: ...

class StatsPage:
    """The container's end of its stats page, for `stats_page.StatsPage`.

    Parameters
    ----------
    descriptor
        From `stats_page.new_memory`; not needed any more when this returns.
    """

    def __init__(self, descriptor: int) -> None: ...
    def beat(self) -> None: ...

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
    ): ...
    def heartbeat(self) -> int: ...
    def commands(self) -> list[int]: ...

class ComponentCounters:
    """What a component used and did, in a stats page or not."""

    def __init__(self) -> None: ...
    def begin(self) -> None: ...
    def watch(self, process: int) -> None: ...
    def end(self) -> None: ...
    def note_idle(self) -> None: ...
    def note_busy(self) -> None: ...
    def note_asked(self) -> None: ...
    def note_done(self) -> None: ...
    def plan(self, timers: Sequence[tuple[float, float]]) -> None: ...
    def cpu(self) -> float: ...
    def enter(self, page: StatsPage, name: str, epoch: int) -> bool: ...
    def leave(self) -> None: ...

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
    ) -> None: ...
    def add_message(
        self,
        bytes_out: int = 0,
        bytes_in: int = 0,
        latency: float = ...,
        error: float = 0.0,
    ) -> None: ...
    @property
    def cpu(self) -> float: ...
    def add_cpu(self, seconds: float) -> None: ...
    def enter(self, page: StatsPage, name: str) -> bool: ...
    def attribute(
        self, source: ComponentCounters | None, target: ComponentCounters | None
    ) -> None: ...
    def leave(self) -> None: ...

class DirectCall:
    """What `direct_call` returns holds."""

def direct_call(
    method: Callable[..., Any],
    exclusion: Exclusion,
    limit: float,
    counts: Counts,
    translate: Callable[[Exception | SystemExit], NoReturn],
    resend: Callable[..., Any] | None = None,
) -> Callable[..., Any]: ...

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
) -> Frame: ...
