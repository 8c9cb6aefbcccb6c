"""The base class of everything that Poise places, starts and moves."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar, Literal, ParamSpec, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import ComponentClock
from poise.errors import UsageError, did_you_mean, listed
from poise.runtime import _calls
from poise.runtime.component.parameters import (
    Values,
    as_declared,
    parameters_type,
    plain,
)
from poise.runtime.component.started_calls import (
    ImmediateCalls,
    StartedCall,
    StartedCalls,
)
from poise.runtime.execution.mailbox import WorkSource
from poise.wire.connections import connection

Verb = Literal["start", "pause", "resume", "cancel"]
"""What can be done with a task."""

P = ParamSpec("P")
R = TypeVar("R")

_LONGEST = 1e9
"""What is longer is no limit [s]."""


class Context(Struct, frozen=True, kw_only=True):
    """What a container gives a component at birth.

    `count_process`: lets a process's CPU time count as its own; 0: that of its thread.
    `give_up`: ends the container, for this reason; the agent starts it again.
    `listen`: lets its thread get work from a `WorkSource`, too; None: no more.
    `follows`: whether it is made ready while its predecessor is at work.
    `takes_over`: whether it is about to go on with the work of its predecessor.
    `age`: returns how long ago the last message of a subscribed port came [s].
    """

    name: str
    parameters: Any
    devices: Mapping[str, str]
    clock: ComponentClock
    measure: Callable[[str, float], None]
    count_process: Callable[[int], None] = lambda _: None
    give_up: Callable[[str], None] = lambda _: None
    request: Callable[[Verb, str], None] = lambda *_: None
    calls: StartedCalls = ImmediateCalls()
    listen: Callable[[WorkSource | None], None] = lambda _: None
    follows: bool = False
    takes_over: Callable[[], bool] = lambda: False
    age: Callable[[str], float] = lambda _: math.inf


class TaskRequests:
    """Asks the manager to start, pause, resume or cancel tasks of the robot.

    Nothing waits for it. What the manager refuses is in its journal; it does what is
    asked when it is back, if it is away.
    """

    def __init__(self, request: Callable[[Verb, str], None]) -> None:
        self._request = request

    def start(self, task: str) -> None:
        """Start a task, with the priority that the robot file gives it."""
        self._ask("start", task)

    def pause(self, task: str) -> None:
        """Let a task wait until it is resumed."""
        self._ask("pause", task)

    def resume(self, task: str) -> None:
        """Let a paused task go on."""
        self._ask("resume", task)

    def cancel(self, task: str) -> None:
        """End a task."""
        self._ask("cancel", task)

    def _ask(self, verb: Verb, task: str) -> None:
        _check_text("a task", task)
        self._request(verb, task)


def _check_text(what: str, name: object) -> None:
    """Raise UsageError for a name that could not be told to the agent."""
    if not isinstance(name, str):
        raise UsageError(f"the name of {what} is a text, not {name!r}")


class Component:
    """A unit of robot software with typed ports (`poise.runtime.component.ports`).

    One thread at a time runs its code, and the same code serves when the other ends
    of its connectors are in this process or on another computer. Attributes of its own
    are best set in `configure`.

    The hooks are called in ROS 2's order, each once per transition, never while
    anything else of the component runs: `configure` (unconfigured -> inactive),
    `activate` (inactive -> active), `deactivate`, `cleanup`. A hook that raises stops
    the run with the component's name and the traceback. Calls through required ports
    are possible from `activate` on.
    """

    _start_parameters: ClassVar[frozenset[str]] = frozenset()
    reentrant: ClassVar[bool] = False
    """Whether others may call it while it waits in a call that it makes itself.

    Still one thread at a time runs its code, but its attributes may have changed when
    the call comes back. Where calls go round, from component to component, one of these
    components must say so (`poise check`). It holds for calls from timers, messages and
    provided methods, not for those from hooks.
    """

    _context: Context

    @property
    def name(self) -> str:
        """Its name in the robot file."""
        return self._context.name

    @property
    def parameters(self) -> Any:  # noqa: ANN401, as its class declares
        """Its parameters, from the robot file or as they were set since.

        Values by name; or, where the class says ``parameters: Gains``, that Struct.
        """
        return self._context.parameters

    @property
    def clock(self) -> ComponentClock:
        """The clock to stamp and measure by; times in [s].

        A time that goes to other components goes as a `poise.Stamp`, which `stamp`
        gives: only `since` knows how old that is on another computer.
        """
        return self._context.clock

    @property
    def log(self) -> logging.Logger:
        """Its logger, ``poise.component.<name>``."""
        return logging.getLogger(f"poise.component.{self.name}")

    @property
    def tasks(self) -> TaskRequests:
        """The robot's tasks: ``self.tasks.start("fetch")``."""
        return TaskRequests(self._context.request)

    def start_call(
        self, call: Callable[P, R], *args: P.args, **kwargs: P.kwargs
    ) -> StartedCall[R]:
        """Start a call without waiting for it: so two can be asked at once.

        ::

            first = self.start_call(self.heating.heat, 0.4)
            second = self.start_call(self.camera.look)
            first.then(self.on_heat)     # later, in a turn of its own
            picture = second.result()    # or wait for it here

        The connector's limit holds, and that of `poise.within`, from now on. A move
        waits for the answers.

        Parameters
        ----------
        call
            A method of a ``Required`` port.
        *args, **kwargs
            Its arguments.

        Raises
        ------
        RunError
            64 of the component's calls wait for answers, or no thread is free.
        UsageError
            It is a method of the component, which only one thread runs at a time.
        """
        if getattr(call, "__self__", None) is self:
            raise UsageError(
                f"start_call of '{self.name}' takes a method of a Required port, as in "
                "self.heating.heat, not a method of the component itself"
            )
        return self._context.calls.start(call, *args, **kwargs)

    def age(self, port: str) -> float:
        """Return how long ago the last message came at a subscribed port [s].

        Infinite when none has come here yet. Messages that wait in the port's queue
        count, too. How old the data is that they carry is another matter: `clock.since`
        of a stamp says it.

        Raises
        ------
        UsageError
            It subscribes to no such port.
        """
        return self._context.age(port)

    def device(self, name: str) -> str:
        """Return the path of a device that the robot file gives this component.

        Raises
        ------
        UsageError
            When the component does not list the device.
        """
        try:
            return self._context.devices[name]
        except KeyError:
            listed = ", ".join(self._context.devices) or "none"
            raise UsageError(
                f"component '{self.name}' asks for device '{name}', "
                f"but lists only: {listed}"
            ) from None

    def measure(self, name: str, value: float) -> None:
        """Count `value` under `name`; count, mean, maximum and median are reported.

        What is no number (NaN) counts as 0. A component has at most 100 names; the log
        says so when one is not counted.

        Raises
        ------
        UsageError
            The name is no text, or the value is of no type of numbers.
        """
        _check_text("a measure", name)
        try:
            math.isnan(value)
        except TypeError:
            raise UsageError(f"measure '{name}': {value!r} is not a number") from None
        self._context.measure(name, value)

    def configure(self) -> None:
        """Make ready what `parameters` and devices ask for; the ports are not wired."""

    def reconfigure(self, parameters: Any) -> None:  # noqa: ANN401, ARG002
        """Take other parameters while it runs, or refuse them by raising.

        Called while nothing else of it runs; `self.parameters` has the old ones until
        it returns. Where it is not overridden, all changes are refused.
        """
        raise UsageError(
            f"'{self.name}' takes no parameters while it runs: "
            f"{type(self).__qualname__} has no `reconfigure`"
        )

    def _settable(self) -> Mapping[str, Any]:
        """Return the parameters that may be set while it runs."""
        return shown_parameters(self)

    def activate(self) -> None:
        """Begin to work: the ports are wired, timers and messages come afterwards."""

    def begin(self, action: str) -> None:
        """Begin an action whose end it says: one that a port of it `ends`.

        Called on its own thread while it is active, like a timer: when the action
        begins, not when it goes on after a pause or a move. Called again when the
        component was restarted without its state.
        """

    def deactivate(self) -> None:
        """Stop to work: no timer or message comes any more."""

    def cleanup(self) -> None:
        """Give back what `configure` took. Called also after an error."""

    def snapshot(self) -> Struct | None:
        """Return the state to hand over to a successor; None: there is none.

        Called when the component moves or is replaced, while nothing else of it runs.
        """
        return None

    def restore(self, state: Any) -> None:  # noqa: ANN401, what snapshot returned
        """Take what `snapshot` gave; called between `configure` and `activate`.

        The parameter's annotation says the type of the state. An error here calls the
        move off: the component goes on where it was.
        """

    def snapshot_delta(self) -> Struct | None:
        """Return what changed since the last `snapshot` or `snapshot_delta`.

        Offer it together with `restore_delta` when the state is large: then it is
        sent while the component still works, and only the changes while it stands.
        """
        return None

    def restore_delta(self, delta: Any) -> None:  # noqa: ANN401, what snapshot_delta returned
        """Take what `snapshot_delta` gave, on top of the restored state.

        The parameter's annotation says the type of the changes.
        """


C = TypeVar("C", bound=Component)


def create(implementation: type[C], context: Context) -> C:
    """Return a new component that knows its context already in ``__init__``."""
    component = implementation.__new__(implementation)
    parameters = as_declared(implementation, context.parameters)
    component._context = replace(context, parameters=parameters)  # noqa: SLF001, this is its constructor
    component.__init__()  # type: ignore[misc]
    return component


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Give up the calls of a block that are not answered in time, by `Timeout`.

    For when an answer is wanted sooner than a connector's `limit`: what is longer than
    that, or than an outer block, changes nothing.

    Parameters
    ----------
    seconds
        For all calls of the block together; with 0 or less none is made [s].

    Raises
    ------
    UsageError
        `seconds` is no number.
    """
    if math.isnan(seconds):
        raise UsageError("within(nan): give a number of seconds")
    before = _calls.deadline()
    if seconds < _LONGEST:
        moment = time.monotonic_ns() + round(1e9 * max(seconds, -_LONGEST))
        _calls.set_deadline(min(before, moment))
    try:
        yield
    finally:
        _calls.set_deadline(before)


def time_left() -> float:
    """Return how long the caller of the call on this thread still waits [s].

    0 when it gave up or ended: nobody takes the answer, and the callee may
    stop. Infinite in a timer, a message and a hook, and on threads of your own.
    """
    left = max(0.0, _calls.time_left(math.inf))
    return 0.0 if left > 0.0 and connection.is_gone() else left


def _like(before: object, value: object) -> object:
    """Return a value with real numbers where it had some: `5` is 5.0 there."""
    if isinstance(before, Mapping) and isinstance(value, Mapping):
        return {name: _like(before.get(name), part) for name, part in value.items()}
    if isinstance(before, float) and type(value) is int:
        return float(value)
    if isinstance(before, list) and isinstance(value, list) and before:
        return [_like(before[0], part) for part in value]
    return value


def shown_parameters(component: Component) -> dict[str, Any]:
    """Return a component's parameters without those that say how it is started."""
    own = component._start_parameters  # noqa: SLF001, of its own class
    return {k: v for k, v in plain(component.parameters).items() if k not in own}


def set_parameters(component: Component, changes: Values) -> None:
    """Let a component take other values of some of its parameters, or none of them.

    Raises UsageError where a name or value does not fit, and what `reconfigure` raises.
    """
    now = plain(component.parameters)
    settable = component._settable()  # noqa: SLF001, of its own class
    known = parameters_type(type(component))
    for name in changes:
        if known is None and name not in settable:
            raise UsageError(
                f"'{component.name}' has no parameter '{name}'"
                f"{did_you_mean(name, settable)}; it has {listed(settable)}"
            )
    alike = {name: _like(settable.get(name), value) for name, value in changes.items()}
    new = as_declared(type(component), {**now, **alike})
    component.reconfigure(new)
    component._context = replace(component._context, parameters=new)  # noqa: SLF001, its part
