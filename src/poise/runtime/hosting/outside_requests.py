"""Messages and calls that come from outside the robot, by way of its manager.

They enter a component as its own threads do, in its exclusion: so a move loses and
doubles none, and whoever comes too late for a move is told to ask at the new place.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Annotated, Any, NoReturn, get_args, get_origin

from msgspec import Struct, structs

from poise import threads
from poise.errors import (
    CalleeError,
    PoiseError,
    Timeout,
    UsageError,
    did_you_mean,
    encodable,
    listed,
)
from poise.runtime.component.component import (
    Component,
    set_parameters,
    shown_parameters,
    within,
)
from poise.runtime.component.parameters import plain
from poise.runtime.component.ports import Port
from poise.runtime.connectors.interface import Method, message_tag, methods
from poise.runtime.connectors.route import direct_call, raise_callee_error
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.exclusion import Redirected, new_chain
from poise.runtime.execution.mailbox import Feed
from poise.runtime.hosting.output import write_as
from poise.runtime.hosting.runner import Runner
from poise.wire.codec import Packed, WireError, pack, unpack
from poise.wire.records.request_records import (
    MOST_PACKED,
    PARAMETERS,
    PortAnswer,
    PortRequest,
)

_THREADS = 4
_MOST_WAITING = 64
"""So many requests wait in a container; further ones are refused."""
_SHORT = 0.01
"""A shorter wait behind other requests is not mentioned [s]."""


class Away(Exception):
    """The component does not work here; nothing was done."""


class OutsideRequests:
    """Carries out what comes from outside, on threads of its own."""

    def __init__(
        self,
        runner_of: Callable[[str], Runner | None],
        answer: Callable[[PortAnswer], object],
    ) -> None:
        self._runner_of = runner_of
        self._answer = answer
        self._threads = ThreadPoolExecutor(
            _THREADS, "outside", threads.take_poise_name, ("outside",)
        )
        self._room = threading.Semaphore(_MOST_WAITING)
        self._feeds: dict[tuple[Runner, str], Feed] = {}

    def take(self, request: PortRequest) -> None:
        """Take a request; it is answered later."""
        if not self._room.acquire(blocking=False):
            why = f"{_MOST_WAITING} requests from outside wait for this container"
            self._answer(PortAnswer(number=request.number, outcome="late", reason=why))
            return
        until = time.monotonic() + request.limit
        self._threads.submit(self._carry_out, request, until)

    def forget(self, runner: Runner) -> None:
        """Forget a component that is not here any more."""
        for key in [key for key in list(self._feeds) if key[0] is runner]:
            del self._feeds[key]

    def close(self) -> None:
        """Begin no more."""
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _carry_out(self, request: PortRequest, until: float) -> None:
        try:
            answer = self._outcome(request, until)
        except Exception as error:  # noqa: BLE001, a defect must not stop the others
            threads.report_failure()
            answer = PortAnswer(
                number=request.number, outcome="refused", reason=f"a defect: {error!r}"
            )
        finally:
            self._room.release()
        self._answer(answer)

    def _outcome(self, request: PortRequest, until: float) -> PortAnswer:
        waited = time.monotonic() - until + request.limit
        answer = partial(PortAnswer, number=request.number)
        try:
            result = self._done(request, until)
        except CalleeError as error:
            return answer(
                outcome="raised",
                reason=error.message,
                error_type=error.type_name,
                traceback=error.traceback,
            )
        except Timeout as error:
            why = str(error)
            if _SHORT < waited < request.limit:
                why += f", after {waited:.3g} s behind other requests from outside"
            return answer(outcome="late", reason=why)
        except Away as error:
            return answer(outcome="away", reason=str(error))
        except PoiseError as error:
            why = encodable(str(error))  # a user's hook may raise one, too
            return answer(outcome="refused", reason=why)
        return _done_with(answer, result)

    def _done(self, request: PortRequest, until: float) -> Any:  # noqa: ANN401, a result
        write_as(request.component)
        if time.monotonic() > until:
            raise Timeout("others were carried out for all of its limit; it was not")
        runner = self._runner_of(request.component)
        if runner is None:
            raise Away(f"component '{request.component}' is not here")
        if (state := runner.life_cycle.state) != "active":
            raise Away(f"component '{request.component}' is {state}")
        if runner.is_fenced:
            raise Away(f"the lease of component '{request.component}' has ended")
        if request.port == PARAMETERS:
            return _parameters(runner, request, until)
        port = _port(runner, request)
        if port.kind == "provides":
            return self._call(runner, port, request, until)
        message = _converted(request.value, port.type, "the message")
        if port.kind == "publishes":
            publish = getattr(runner.component, port.name).publish
            _inside(runner, until, lambda: publish(message))
        else:
            self._queue(runner, port, (message_tag(port.type), message), until)
        return None

    def _call(
        self, runner: Runner, port: Port, request: PortRequest, until: float
    ) -> Any:  # noqa: ANN401, a result
        method = _method(port, request)
        arguments = _arguments(method, request)
        if method.oneway:
            self._queue(runner, port, (method.tag, arguments), until)
            return None

        def away(*_: object, **__: object) -> NoReturn:
            raise Away(f"component '{runner.spec.name}' has moved")

        new_chain()
        left = max(0.0, until - time.monotonic())
        code = getattr(runner.component, method.name)
        call = direct_call(code, runner.exclusion, left, runner.outside_calls, away)
        with within(left):
            return call(*arguments)

    def _queue(
        self, runner: Runner, port: Port, entry: tuple[int, Any], until: float
    ) -> None:
        """Put a message into a port's queue, when there is room."""
        key = runner, port.name
        if (feed := self._feeds.get(key)) is None:
            feed = runner.endpoints.mailbox.feed(port.name, Counts())
            self._feeds[key] = feed
        threads.poll_until(feed.has_room, until, f"port '{port.name}' has no room")
        _inside(runner, until, lambda: feed.put(entry))


def _done_with(answer: Callable[..., PortAnswer], result: object) -> PortAnswer:
    """Return what says that a request was carried out, with its result."""
    try:
        value = pack(result)
    except WireError as error:
        why = encodable(f"it was called, but its result is lost: {error}")
        return answer(outcome="cannot cross", reason=why)
    if value.size > MOST_PACKED:
        why = f"it was called, but its result has {value.size} B, over {MOST_PACKED} B"
        return answer(outcome="cannot cross", reason=why)
    return answer(outcome="done", value=value)


def _inside(runner: Runner, until: float, do: Callable[[], object]) -> None:
    """Do something where no move is under way."""
    try:
        runner.exclusion.enter(new_chain(), max(0.0, until - time.monotonic()))
    except Redirected:
        raise Away(f"component '{runner.spec.name}' has moved") from None
    try:
        do()
    finally:
        runner.exclusion.leave()


def _parameters(runner: Runner, request: PortRequest, until: float) -> dict[str, Any]:
    """Return parameters, all or those that are set."""
    component = runner.component
    _, changes = unpack(request.value, tuple[list[Any], dict[str, Any]])
    if request.method == "get":
        return shown_parameters(component)

    def change() -> None:
        try:
            set_parameters(component, changes)
            runner.parameters_set |= unpack(pack(_now(component, changes)))
        except PoiseError:
            raise
        # a user's hook may raise anything
        except BaseException as error:  # noqa: BLE001
            raise_callee_error(error)

    _inside(runner, until, change)
    return _now(component, changes)


def _now(component: Component, names: Iterable[str]) -> dict[str, Any]:
    """Return some parameters, as they are now."""
    now = plain(component.parameters)
    return {name: now[name] for name in names}


def _port(runner: Runner, request: PortRequest) -> Port:
    name, ports = runner.spec.name, runner.ports
    fitting = {
        port.name: port
        for port in ports.values()
        if (port.kind == "provides") == bool(request.method) and port.kind != "requires"
    }
    if request.port in fitting:
        return fitting[request.port]
    does = "answer calls" if request.method else "take or publish messages"
    known = f"ports that {does}: {listed(fitting)}"
    if request.port in ports:
        raise UsageError(f"'{name}.{request.port}' does not {does}; {known}")
    guess = did_you_mean(request.port, fitting)
    raise UsageError(f"component '{name}' has no port '{request.port}'{guess}; {known}")


def _method(port: Port, request: PortRequest) -> Method:
    known = {method.name: method for method in methods(port.type).values()}
    if request.method not in known:
        guess = did_you_mean(request.method, known)
        raise UsageError(
            f"'{request.component}.{port.name}' has no method '{request.method}'"
            f"{guess}; methods: {listed(known)}"
        )
    return known[request.method]


def _arguments(method: Method, request: PortRequest) -> tuple[Any, ...]:
    """Return a call's arguments as its method declares them."""
    places, names = unpack(request.value, tuple[list[Any], dict[str, Any]])
    try:
        bound = method.bind(*places, **names)
    except TypeError as error:
        raise UsageError(f"{request.method}: {error}") from error
    types = get_args(method.arguments.type)
    return tuple(
        _converted(pack(value), type_, f"argument {number} of {method.name}")
        for number, (value, type_) in enumerate(zip(bound, types, strict=True), 1)
    )


def _converted(value: Packed, type_: Any, what: str) -> Any:  # noqa: ANN401, any type
    try:
        converted = unpack(value, type_)
        unknown = next(_unknown(unpack(value), converted), "")
    except WireError as error:
        raise UsageError(f"{what} is not of type {_name(type_)}: {error}") from error
    if unknown:
        raise UsageError(f"{what}: {unknown}")
    return converted


def _unknown(given: object, taken: object) -> Iterator[str]:
    """Yield what is said of given fields that what was taken has not."""
    pairs: Iterable[tuple[object, object]] = ()
    if isinstance(given, dict) and isinstance(taken, Struct):
        fields = {each.encode_name: each.name for each in structs.fields(taken)}
        named = [*fields, taken.__struct_config__.tag_field]
        for name in given:
            if name not in named:
                guess, type_ = did_you_mean(name, fields), _name(type(taken))
                yield f"{type_} has no '{name}'{guess}; it has {listed(fields)}"
        known = [name for name in given if name in fields]
        pairs = ((given[name], getattr(taken, fields[name])) for name in known)
    elif isinstance(given, dict) and isinstance(taken, dict):
        pairs = zip(given.values(), taken.values(), strict=False)
    elif isinstance(given, list) and isinstance(taken, list | tuple):
        pairs = zip(given, taken, strict=False)
    for part, taken_part in pairs:
        if isinstance(part, dict | list):
            yield from _unknown(part, taken_part)


def _name(type_: object) -> str:
    plain = get_args(type_)[0] if get_origin(type_) is Annotated else type_
    return getattr(plain, "__qualname__", str(plain))
