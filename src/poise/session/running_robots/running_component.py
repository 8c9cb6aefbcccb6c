"""A component of a running robot: to call it, send it messages, and hear its own."""

from __future__ import annotations

import contextlib
import math
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar, cast, get_type_hints

import yaml
from msgspec import structs

from poise.decoding import convert, from_json
from poise.errors import (
    CalleeError,
    CannotCross,
    PoiseError,
    RunError,
    Timeout,
    UsageError,
)
from poise.manage.control_socket.commands import (
    ParametersCommand,
    PortCommand,
    TapCommand,
)
from poise.manage.control_socket.control_client import ask
from poise.runtime._calls import time_left
from poise.units import quoted
from poise.wire.codec import Packed, WireError, pack, unpack
from poise.wire.records.request_records import PARAMETERS, PortAnswer, TapReading

_LOOK_EVERY = 0.05
_PATIENCE = 10.0
"""A source that was killed, and its connector, are there again within this time [s]."""
I = TypeVar("I")  # noqa: E741, an interface
T = TypeVar("T")


def value_of(text: str) -> Any:  # noqa: ANN401, YAML's
    """Return the value that a text in JSON or YAML has.

    JSON comes first: for YAML, ``1e-3`` and a pair of surrogates are something else.
    """
    with contextlib.suppress(ValueError, RecursionError):
        return from_json(text, Any)
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        # PyYAML raises ValueError for some dates and numbers, such as 2026-02-30
        why = getattr(error, "problem", "") or str(error).partition("\n")[0]
        what = f"{quoted(text)} is neither JSON nor YAML: {why}"
        raise UsageError(what) from error


class RunningComponent:
    """A component of a robot that is up, wherever it runs at the moment.

    Nothing that is sent is lost or doubled while the component moves. Every method
    raises `UsageError` for what does not fit: a component, port, method, argument or
    message; `RunError` when nobody took it within its limit; and `NoManager` when the
    robot goes on without one.

    Parameters
    ----------
    robot
        The robot's name; None: the only one that runs here.
    name
        The component's.
    """

    def __init__(self, robot: str | None, name: str) -> None:
        self._robot = robot
        self.name = name

    def call(
        self,
        port: str,
        method: str,
        /,
        *args: object,
        limit: float = 1.0,
        returns: Any = Any,  # noqa: ANN401, any type
        **kwargs: object,
    ) -> Any:  # noqa: ANN401, of the type that it returns
        """Call a method of one of its interfaces, and return the result.

        Parameters
        ----------
        port
            A ``Provided`` port.
        method
            One of its interface.
        *args, **kwargs
            The method's arguments: of its types, or plain data that fits them. One that
            is named as what follows here goes by its place.
        limit
            How long it waits at most, also while the component moves [s]; up to 50.
        returns
            The type of the result; else it is plain data, with arrays.

        Raises
        ------
        CalleeError
            The method raised.
        CannotCross
            It was called, and its result is not plain data, or too large.
        Timeout
            There was no answer in time; the method may still run.
        """
        return self.call_with(port, method, args, kwargs, limit=limit, returns=returns)

    def call_with(
        self,
        port: str,
        method: str,
        args: Sequence[object] = (),
        kwargs: Mapping[str, object] = {},
        *,
        limit: float = 1.0,
        returns: Any = Any,  # noqa: ANN401, any type
    ) -> Any:  # noqa: ANN401, of the type that it returns
        """Call a method as `call` does, with arguments of any names."""
        answer = self._ask(port, method, (args, kwargs), limit)
        try:
            return unpack(answer.value, returns)
        except WireError as error:
            what = getattr(returns, "__qualname__", str(returns))
            returned = f"'{self.name}.{port}' returned no {what}: {error}"
            raise UsageError(returned) from error

    def interface(self, port: str, type_: type[I], *, limit: float = 1.0) -> I:
        """Return its interface at a port, to be called as a component calls it.

        Parameters
        ----------
        type_
            The port's interface, as in ``Provided[...]``: results are of its types.
        limit
            How long each call waits at most [s]; up to 50.
        """
        return cast("I", _Interface(self, port, type_, limit))

    def publish(self, port: str, message: object, *, limit: float = 1.0) -> None:
        """Send a message.

        Parameters
        ----------
        port
            A topic: it goes to all who are connected, as if the component had published
            it. Or a port with ``@subscribed``: only this component gets it.
        message
            Of the port's type, or plain data that fits it.
        limit
            How long it waits at most for the component, and for room [s]; up to 50.

        Raises
        ------
        Timeout
            It was not taken in time, for example as there was no room; it may still be.
        """
        self._ask(port, "", message, limit)

    def subscribe(self, port: str, type_: type[T]) -> Iterator[T]:
        """Yield what goes out from a topic, or in at a port with ``@subscribed``.

        Where a port is ``published(latest=True)``, its last message comes first. After
        the component's container ended it waits for the next one, up to 10 s.
        What goes out while nobody takes from the iterator is lost beyond 100 messages
        or 16 MiB, and then `RunError` says how many; a robot waits for no viewer.

        Parameters
        ----------
        type_
            The type of the messages; ``dict``: plain data, with arrays.
        """
        viewer, connector = secrets.token_hex(8), f"{self.name}.{port}"
        command = TapCommand(connector, viewer, _ALL, is_whole=True, latest=(0, 0))
        seen_at = -math.inf
        while True:
            try:
                reading = ask(self._robot, command, TapReading)
            except PoiseError:  # its source may be about to be there again
                if time.monotonic() - seen_at > _PATIENCE:
                    raise
                time.sleep(_LOOK_EVERY)
                continue
            seen_at = time.monotonic()
            command = structs.replace(command, latest=reading.latest)
            for passed in reading.passed:
                if not passed.is_whole:
                    raise RunError(f"a message of '{connector}': {passed.value}")
                packed = convert(passed.value, Packed)
                try:
                    yield unpack(packed, type_)
                except WireError as error:
                    raise UsageError(f"no message of '{connector}': {error}") from error
            lost = len(reading.times) - len(reading.passed) + reading.missing
            if lost:
                raise RunError(
                    f"{lost} messages of '{connector}' were lost: they came faster "
                    "than they were taken"
                )
            time.sleep(_LOOK_EVERY)

    def parameters(self, *, limit: float = 1.0) -> dict[str, Any]:
        """Return its parameters by name, as they are now.

        Parameters
        ----------
        limit
            How long it waits at most [s]; up to 50.
        """
        return dict(unpack(self._ask(PARAMETERS, "get", ((), {}), limit).value))

    def set_parameters(
        self, changes: Mapping[str, object], *, limit: float = 1.0
    ) -> dict[str, Any]:
        """Set some of its parameters; return them as it took them.

        They hold for as long as the robot is up: after moves and restarts, on another
        computer, and under another manager. The robot file stays as it is.

        Parameters
        ----------
        changes
            Their names and values; quantities may have units.
        limit
            How long it waits at most [s]; up to 50.

        Raises
        ------
        CalleeError
            Its ``reconfigure`` refused them: none has changed.
        """
        packed = _packed(dict(changes))
        command = ParametersCommand(component=self.name, changes=packed, limit=limit)
        return dict(unpack(self._sent(command, PARAMETERS).value))

    def _ask(self, port: str, method: str, value: object, limit: float) -> PortAnswer:
        packed = _packed(value)
        command = PortCommand(
            component=self.name, port=port, method=method, value=packed, limit=limit
        )
        return self._sent(command, port)

    def _sent(self, command: PortCommand | ParametersCommand, port: str) -> PortAnswer:
        """Send a command, within what `poise.within` leaves of its limit."""
        limit = time_left(command.limit)
        if command.limit > 0 >= limit:
            raise Timeout(f"'{self.name}.{port}': no time is left")
        command = structs.replace(command, limit=limit)
        answer = ask(self._robot, command, PortAnswer)
        match answer.outcome:
            case "raised":
                raise CalleeError(answer.error_type, answer.reason, answer.traceback)
            case "late":
                raise Timeout(f"'{self.name}.{port}': {answer.reason}")
            case "cannot cross":
                raise CannotCross(f"'{self.name}.{port}': {answer.reason}")
            case "refused":
                raise UsageError(answer.reason)
        return answer


_ALL = 1e6
"""So many messages a second come with their content: all."""


class _Interface:
    """Calls a component as its interface has it."""

    def __init__(
        self, component: RunningComponent, port: str, type_: type, limit: float
    ) -> None:
        self._component = component
        self._port = port
        self._type = type_
        self._limit = limit

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401, a method
        method = getattr(self._type, name)
        returns = get_type_hints(method).get("return", type(None))

        def call(*args: object, **kwargs: object) -> Any:  # noqa: ANN401, its result
            return self._component.call_with(
                self._port, name, args, kwargs, limit=self._limit, returns=returns
            )

        return call


def _packed(value: object) -> Packed:
    try:
        return pack(value)
    except WireError as error:
        raise UsageError(str(error)) from error
