"""Typed ports: how a component says what it offers and what it needs.

::

    class Localiser(Component):
        poses: Provided[Poses]           # others call the methods of `Poses` on me
        walls: Required[Walls]           # I call the methods of `Walls` on another
        pose: Published[Pose]            # I publish messages of type `Pose`
        map: Published[Map] = published(latest=True)  # late subscribers get the last

        @subscribed("scan", keep=1)      # messages come to me; the port is `scan`
        def on_scan(self, message: Scan) -> None: ...

        @lost("scan")                    # nobody publishes there any more
        def brake(self) -> None: ...

        @every(hz=5, deadline=0.2)       # not a port: a timer
        def cycle(self) -> None: ...

The component never learns where the other ends are.
"""

from __future__ import annotations

import inspect
import reprlib
from collections.abc import Callable, Container, Iterator, Mapping
from itertools import chain
from numbers import Real
from types import FunctionType, NoneType
from typing import (
    Annotated,
    Any,
    Generic,
    Literal,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
from msgspec import Struct, StructMeta

from poise.errors import UsageError, did_you_mean, listed
from poise.runtime.component.signatures import check_takes

I = TypeVar("I")  # noqa: E741, an interface
M = TypeVar("M")
F = TypeVar("F", bound=Callable[..., Any])

PortKind = Literal["provides", "requires", "publishes", "subscribes"]
Policy = Literal["keep", "block"]
InputEvent = Literal["lost", "found"]
_SHORTEST, _LONGEST = 1e-9, 1e9
"""Periods of timers [s]: beyond, no clock and no wait of Python's has room for them."""


@dataclass_transform(frozen_default=True, field_specifiers=(msgspec.field,))
class _MessageMeta(StructMeta):
    """Tells type checkers that the subclasses of `Message` are frozen, too."""


class Message(Struct, metaclass=_MessageMeta, frozen=True):
    """Base of messages and states: typed, and not changed once handed over.

    Fields may be anything msgspec encodes, other messages, and NumPy arrays. An array
    from another container is read-only; within one, it is the sender's own.
    """


class _Provides:
    """Marks the annotation of a provided port."""


class _Requires:
    """Marks the annotation of a required port."""


Provided = Annotated[I, _Provides]
"""``name: Provided[Interface]``: the component itself has the interface's methods."""

Required = Annotated[I, _Requires]
"""``name: Required[Interface]``: ``self.name`` has the interface's methods.

Each call may block up to the connector's time limit and raises
`poise.errors.Unavailable`, `Timeout`, or `CalleeError` with what the callee raised.
"""


class Published(Generic[M]):
    """``name: Published[MessageType]``: a topic that the component publishes."""

    __slots__ = ("_send", "_type")

    def __init__(self, send: Callable[[M], None], type_: object = object) -> None:
        self._send = send
        self._type = type_ if isinstance(type_, StructMeta) else object

    def publish(self, message: M) -> None:
        """Hand `message` to every subscriber, in order.

        Waits only while a subscriber that asked for it (``subscribed(block=n)``) has no
        room, and up to the connector's time limit; then the message is dropped for that
        subscriber, logged and counted as a drop of the connector. The message must not
        be changed afterwards.

        Raises
        ------
        UsageError
            It is of another type than the port says.
        """
        if not isinstance(message, self._type):
            _refuse_type(message, self._type)
        self._send(message)


class _Publication(Struct, frozen=True):
    """What a class says of a published port besides its type."""

    latest: bool


def published(*, latest: bool = False) -> Any:  # noqa: ANN401, stands for the port
    """Say how a port publishes: ``map: Published[Map] = published(latest=True)``.

    Parameters
    ----------
    latest
        Whoever subscribes later, or was restarted, gets the last message at once, and
        no message twice. The port keeps it, and a move takes it along; so do
        checkpoints.
    """
    return _Publication(latest)


class Queue(Struct, frozen=True):
    """How a subscriber queues: keep the last `size` messages, or block at `size`."""

    policy: Policy = "keep"
    size: int = 1


class Port(Struct, frozen=True):
    """A port, as its class declares it; `type`: a message class, or an interface."""

    name: str
    kind: PortKind
    type: Any
    queue: Queue | None = None
    handler: str = ""  # the method that takes the messages of a subscribed topic
    latest: bool = False  # whether it keeps its last message for late subscribers


class Timer(Struct, frozen=True):
    """A method to be called every `period` [s].

    A release whose run has not ended `deadline` [s] later missed it; so did every
    release that was skipped. `deadline` None: not watched.
    """

    name: str
    period: float
    deadline: float | None = None


def subscribed(
    port: str = "", /, *, keep: int | None = None, block: int | None = None
) -> Callable[[F], F]:
    """Make a method the handler of a subscribed topic.

    Parameters
    ----------
    port
        The port's name; else it has the method's.
    keep
        Queue at most the last `keep` messages; older ones are dropped and counted.
        1 unless `block` is given.
    block
        Queue at most `block` messages of each publisher, and make it wait when they
        are there. From another container it may have to wait until half of them were
        taken. A message that waited for the connector's time limit is dropped.

    The method is called once per message, in the order of publication per publisher,
    while nothing else of the component runs.
    """
    if not isinstance(port, str):
        raise UsageError("@subscribed needs parentheses, as in @subscribed(keep=1)")
    if port and not port.isidentifier():
        raise UsageError(
            f"subscribed({port!r}): a port's name must be an identifier, such as 'scan'"
        )
    if keep is not None and block is not None:
        msg = f"subscribed(keep={keep}, block={block}): give one of them, not both"
        raise UsageError(msg)
    queue = Queue("keep", 1 if keep is None else keep)
    if block is not None:
        queue = Queue("block", block)
    if queue.size < 1:
        msg = f"subscribed({queue.policy}={queue.size}): a queue holds at least 1"
        raise UsageError(msg)

    def mark(method: F) -> F:
        method.__poise_queue__ = (port or method.__name__, queue)  # type: ignore[attr-defined]
        return method

    return mark


def lost(port: str, /) -> Callable[[F], F]:
    """Call a method when nobody is left who publishes to a subscribed port.

    That is a moment after the container at the other end has ended, and 0.4 s after its
    computer was lost or cut off: before Poise starts it elsewhere. It is called once,
    in a turn of its own, also when there is nobody 1 s after the component was
    activated.

    Parameters
    ----------
    port
        The port's name, which `subscribed` declares.
    """
    return _watching("lost", port)


def found(port: str, /) -> Callable[[F], F]:
    """Call a method when somebody publishes again to a port that was `lost`."""
    return _watching("found", port)


def _watching(event: InputEvent, port: str) -> Callable[[F], F]:
    if callable(port) or not port.isidentifier():
        raise UsageError(f"@{event} takes a port's name, as in @{event}('scan')")

    def mark(method: F) -> F:
        method.__poise_input__ = (event, port)  # type: ignore[attr-defined]
        return method

    return mark


def every(
    period: float | None = None,
    *,
    hz: float | None = None,
    deadline: float | None = None,
) -> Callable[[F], F]:
    """Call a method again and again while the component is active.

    Releases keep their phase: they lie at multiples of `period` after a moment that
    follows from the component's name. When releases pass while the method still runs,
    the last of them is run at once afterwards; the others are skipped.

    Parameters
    ----------
    period
        From one release to the next [s]; 1e-9 to 1e9.
    hz
        In place of `period`: releases in a second.
    deadline
        [s] after the release; > 0. None: not watched.
    """
    if callable(period):
        raise UsageError("@every takes its period [s], as in @every(0.1)")
    for given in (period, hz, deadline):
        if not isinstance(given, Real | NoneType):
            raise UsageError(
                f"@every takes seconds as a number, as in @every(0.1), not {given!r}"
            )
    times = {"period": period, "hz": hz, "deadline": deadline}
    values = {name: time for name, time in times.items() if time is not None}
    words = ", ".join(f"{name}={time}" for name, time in values.items())
    call = f"every({words.removeprefix('period=')})"
    if (period is None) == (hz is None):
        raise UsageError(f"{call}: give either, as in @every(0.1) or every(hz=10)")
    for name, time in values.items():
        if not time > 0:
            raise UsageError(f"{call}: {name} must be above 0")
    seconds = 1 / hz if period is None and hz is not None else period
    if seconds is not None and not _SHORTEST <= seconds <= _LONGEST:
        text = f"the period must be from {_SHORTEST:g} to {_LONGEST:g} s"
        raise UsageError(f"{call}: {text}")

    def mark(method: F) -> F:
        method.__poise_timer__ = (seconds, deadline)  # type: ignore[attr-defined]
        return method

    return mark


def oneway(method: F) -> F:
    """Make a method of an interface one-way: the caller does not wait for it."""
    method.__poise_oneway__ = True  # type: ignore[attr-defined]
    return method


def is_oneway(interface: type, method: str) -> bool:
    """Whether `method` of `interface` was declared `oneway`."""
    return bool(getattr(getattr(interface, method), "__poise_oneway__", False))


_OWN = ("name", "clock", "log", "tasks", "start_call", "age", "device", "measure")
"""What `Component` offers, apart from the hooks that classes define."""
_HOOKS = ("configure", "reconfigure", "activate", "begin", "deactivate", "cleanup")
_STATE_HOOKS = ("snapshot", "restore", "snapshot_delta", "restore_delta")
_TAKE = {
    "reconfigure": "parameters",
    "begin": "action",
    "restore": "state",
    "restore_delta": "delta",
}
"""Hooks that take an argument -> its name."""
_RUNS_LATER = inspect.CO_COROUTINE | inspect.CO_GENERATOR | inspect.CO_ASYNC_GENERATOR
_MARKS = ("__poise_queue__", "__poise_input__", "__poise_timer__")
"""What `subscribed`, `lost`, `found` and `every` leave at a method."""


def ports_of(component: type) -> Mapping[str, Port]:
    """Return the ports of a component class by name.

    UsageError: it cannot be run; each line of the message has a reason.
    """
    hints = get_type_hints(component, include_extras=True)
    ports: dict[str, Port] = {}
    if wrong := dict.fromkeys(_wrong(component, hints, ports)):
        raise UsageError("\n".join(wrong))
    return ports


def _wrong(
    component: type, hints: Mapping[str, Any], ports: dict[str, Port]
) -> Iterator[str]:
    """Yield what is wrong with a component class, and add its ports to `ports`."""
    yield from _wrong_names(component, hints)
    for name, hint in hints.items():
        yield from _incomplete(component, name, hint)
        port = _annotated_port(name, hint, getattr(component, name, None))
        if port is not None:
            ports[name] = port
    for name, method in _functions_of(component):
        if hasattr(method, "__poise_queue__"):
            port_name, queue = method.__poise_queue__
            if port_name in ports:
                yield (
                    f"{component.__qualname__}: two ports are named '{port_name}'; "
                    f"one is subscribed by method '{name}'"
                )
            type_ = None
            try:
                type_ = _message_type(method)
            except UsageError as error:
                yield str(error)
            ports[port_name] = Port(port_name, "subscribes", type_, queue, name)
    yield from _wrong_assigned(component)
    yield from _wrong_parameters(component, hints.get("parameters"))
    yield from _wrong_coroutines(component, ports)
    yield from _wrong_calls(component, ports)
    for (event, name), methods in watchers_of(component).items():
        inputs = [port.name for port in ports.values() if port.kind == "subscribes"]
        if name not in inputs:
            yield (
                f"{component.__qualname__}.{methods[0]}: @{event}('{name}') names no "
                f"subscribed port{did_you_mean(name, inputs)}; there are: "
                f"{listed(inputs)}"
            )


def _functions_of(owner: type) -> Iterator[tuple[str, FunctionType]]:
    """Yield the functions of a class by name.

    `inspect.getmembers` reads dictionaries to which another thread adds annotations.
    """
    for name in dir(owner):
        if isinstance(found := getattr(owner, name, None), FunctionType):
            yield name, found


def _wrong_names(component: type, declared: Container[str]) -> Iterator[str]:
    """Yield what of a class hides what each component has of Poise."""
    for name in _OWN:
        if name in declared or sum(name in vars(c) for c in component.__mro__) > 1:
            yield (
                f"{component.__qualname__}.{name}: each component has a '{name}' of "
                "Poise's, which this would hide; name it otherwise"
            )


def _wrong_assigned(component: type) -> Iterator[str]:
    """Yield the ports whose type was assigned, which declares nothing."""
    for name in dir(component):
        if _annotated_port(name, getattr(component, name, None), None) is not None:
            yield (
                f"{component.__qualname__}.{name} is no port: write a colon, not an "
                f"equals sign, as in `{name}: Published[Type]`"
            )


def _incomplete(component: type, name: str, hint: object) -> Iterator[str]:
    """Yield that a port does not say its type or interface."""
    kinds = {"Published": Published, "Provided": Provided, "Required": Required}
    for kind, bare in kinds.items():
        if hint == bare:
            what = "message" if kind == "Published" else "interface"
            yield (
                f"{component.__qualname__}.{name} does not say which {what} it has; "
                f"write its type in brackets, as in `{name}: {kind}[Type]`"
            )


def _wrong_parameters(component: type, declared: object) -> Iterator[str]:
    """Yield that no value can be checked against a class of parameters."""
    if not isinstance(declared, type) or declared is Any:
        return
    if not issubclass(declared, Struct | Mapping):
        yield (
            f"{component.__qualname__}: `parameters: {declared.__qualname__}` declares "
            "nothing; let that class inherit from poise.Message"
        )


def _wrong_coroutines(component: type, ports: Mapping[str, Port]) -> Iterator[str]:
    """Yield the methods that Poise calls and that would not run at all then."""
    provided = [port.type for port in ports.values() if port.kind == "provides"]
    called = {*_HOOKS, *_STATE_HOOKS, *chain.from_iterable(map(methods_of, provided))}
    for name, method in _functions_of(component):
        is_called = name in called or any(hasattr(method, mark) for mark in _MARKS)
        if is_called and method.__code__.co_flags & _RUNS_LATER:
            yield (
                f"{component.__qualname__}.{name}: Poise calls it and awaits nothing; "
                "write it without `async` and `yield`"
            )


def _wrong_calls(component: type, ports: Mapping[str, Port]) -> Iterator[str]:
    """Yield the methods that are not there, or cannot be called as Poise does."""
    watchers = chain.from_iterable(watchers_of(component).values())
    own = ("__init__", *_HOOKS, *_STATE_HOOKS, *timers_of(component), *watchers)
    called = [(name, [_TAKE[name]] if name in _TAKE else []) for name in own]
    for port in ports.values():
        if port.kind == "provides":
            missing = [m for m in methods_of(port.type) if not hasattr(component, m)]
            if missing:
                yield (
                    f"{component.__qualname__} provides {port.name}: "
                    f"{port.type.__qualname__}, but has no method {', '.join(missing)}"
                )
            called += _provided_calls(port.type)
    for name, arguments in called:
        try:
            check_takes(component, name, arguments)
        except UsageError as error:
            yield str(error)


def watchers_of(component: type) -> Mapping[tuple[InputEvent, str], list[str]]:
    """Return what happens to which port -> the methods that are called then."""
    found: dict[tuple[InputEvent, str], list[str]] = {}
    for name, method in _functions_of(component):
        if hasattr(method, "__poise_input__"):
            found.setdefault(method.__poise_input__, []).append(name)
    return found


def timers_of(component: type) -> Mapping[str, Timer]:
    """Return the timers of a component class by method name."""
    return {
        name: Timer(name, *method.__poise_timer__)
        for name, method in _functions_of(component)
        if hasattr(method, "__poise_timer__")
    }


def methods_of(interface: type) -> tuple[str, ...]:
    """Return the names of an interface's public methods."""
    return tuple(
        name for name, _ in _functions_of(interface) if not name.startswith("_")
    )


def _refuse_type(message: object, wanted: type) -> None:
    given = type(message)
    if given.__qualname__ != wanted.__qualname__:  # else imported under two names
        raise UsageError(
            f"the port publishes {wanted.__qualname__}, but was given "
            f"{reprlib.repr(message)} of type {given.__qualname__}"
        )


def _annotated_port(name: str, hint: Any, value: object) -> Port | None:  # noqa: ANN401, any hint
    if get_origin(hint) is Published:
        latest = isinstance(value, _Publication) and value.latest
        return Port(name, "publishes", get_args(hint)[0], latest=latest)
    if get_origin(hint) is Annotated:
        interface, *marks = get_args(hint)
        if _Provides in marks:
            return Port(name, "provides", interface)
        if _Requires in marks:
            return Port(name, "requires", interface)
    return None


def _message_type(method: Callable[..., Any]) -> Any:  # noqa: ANN401, any type
    hints = get_type_hints(method)
    names = list(inspect.signature(method).parameters)[1:]
    if len(names) != 1 or names[0] not in hints:
        raise UsageError(
            f"{method.__qualname__}: a subscribed method takes one message and says "
            f"its type, as in `def {method.__name__}(self, message: Scan) -> None`"
        )
    return hints[names[0]]


def _provided_calls(interface: type) -> Iterator[tuple[str, list[str]]]:
    """Yield methods with the names of their arguments, where each has a place."""
    for name in methods_of(interface):
        signature = inspect.signature(getattr(interface, name))
        own = list(signature.parameters.values())[1:]
        if all(p.kind <= p.POSITIONAL_OR_KEYWORD for p in own):
            yield name, [p.name for p in own]
