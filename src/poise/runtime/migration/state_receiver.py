"""What a new incarnation takes over, and from whom.

From an old incarnation of the same component it takes everything. When a whole
architecture is replaced by its alternative, components go that have no successor of
their name. Then a function of the user's, `adapt`, makes new states from old ones::

    class Before(Message):
        odometry: Odometry      # the state of the component `odometry`

    class After(Message):
        slam: Map               # what the component `slam` is to restore

    def adapt(before: Before) -> After: ...

It is run for every component in `After`, and asks for the states in `Before` alone.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, get_type_hints

import msgspec

from poise.errors import Timeout, UsageError
from poise.priority import ahead, first
from poise.runtime.component.implementation import find_function
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration import state_sender
from poise.runtime.migration.state_sender import Ask, StateTransfer
from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.connections.channel import Channel
from poise.wire.records.migration import Precopy

_POLL = 0.001
"""While one that hands over is not reached, it is looked for this often [s]."""

JOIN_LIMIT = 3.0
"""Who does not offer its hand-over within this time is gone [s]: all others wait."""

ASK_LIMIT = 5.0
"""Old incarnations give within this time after they were asked [s]: the gate is about
to shut, and is shut for less."""

OpenPipe = Callable[[str, str], Channel]
"""Opens a pipe by its key and the address of a container."""


class StateReceiver:
    """A new incarnation in one exchange.

    Raises
    ------
    RobotError, UsageError
        `adapt` cannot be found, or does not say what it takes and gives.
    """

    def __init__(self, runner: Runner, step: Precopy, open_pipe: OpenPipe) -> None:
        self._runner = runner
        self._step = step
        name, adapt = runner.spec.name, runner.spec.adapt
        self._adapt = find_function(adapt) if adapt else None
        self._is_same = name in step.olds
        self._before: Mapping[str, Any] = {}
        if self._adapt is not None and not self._is_same:
            before, after = types_of(self._adapt)
            self._before = before if name in after else {}
        self._open_pipe = open_pipe
        self._channels: dict[str, Channel] = {}
        self._asked: dict[str, Future[StateTransfer]] = {}

    def join(self, deadline: float) -> None:
        """Reach all who hand over; fetch a large state already, while they serve.

        Raises
        ------
        Timeout
            One could not be reached until `deadline` [s, monotonic clock].
        """
        olds = self._step.olds
        for name in self._givers():
            if name not in olds:
                raise UsageError(
                    f"'{self._runner.spec.adapt}' asks for the state of '{name}', "
                    f"which does not go ({', '.join(olds)} do)"
                )
            key = state_sender.key_of(name, olds[name], self._step.number)
            address = self._step.addresses[name]
            self._channels[name] = self._open_pipe(key, address)
        give_up_at = min(deadline, time.monotonic() + JOIN_LIMIT)
        for name, channel in self._channels.items():
            while not channel.is_ready():
                if time.monotonic() > give_up_at:
                    raise Timeout(f"component '{name}' ({olds[name]}) is not reached")
                time.sleep(_POLL)
        if self._is_same and state_sender.offers_delta(self._runner.component):
            left = max(0.0, deadline - time.monotonic())
            channel = self._channels[self._runner.spec.name]
            self._take_all(state_sender.fetch(channel, Ask.STATE, left))

    def ask(self) -> None:
        """Ask the old ones for everything: so the question is there before they give.

        On threads of their own, which only wait.
        """
        state_sender.warm_up(self._runner)
        for name, channel in self._channels.items():
            asked: Future[StateTransfer] = Future()
            self._asked[name] = asked
            with first():
                threading.Thread(
                    target=_fetch, args=(channel, asked), name="heir", daemon=True
                ).start()

    def take_over(self, limit: float) -> None:
        """Take over within `limit` [s], as soon as the old ones give.

        Raises
        ------
        Exception
            One cannot give, or whatever `adapt` and `restore` raise.
        """
        deadline = time.monotonic() + limit
        given = {}
        for name, asked in self._asked.items():
            try:
                given[name] = asked.result(max(0.0, deadline - time.monotonic()))
            except TimeoutError:
                text = f"component '{name}' gave nothing within {limit:g} s"
                raise Timeout(text) from None
        with ahead():  # users' code
            if self._is_same:
                self._take_all(given[self._runner.spec.name])
            else:
                self._succeed(given)
        self.close()

    def close(self) -> None:
        """Ask no more; harmless when repeated."""
        self._asked.clear()
        while self._channels:
            self._channels.popitem()[1].close()

    def _givers(self) -> set[str]:
        if self._is_same:
            return {self._runner.spec.name}
        return set(self._before)

    def _take_all(self, given: StateTransfer) -> None:
        state_sender.take(self._runner, given, self._adapt)

    def _succeed(self, given: Mapping[str, StateTransfer]) -> None:
        """Take what others than an incarnation of the same component hand over."""
        runner = self._runner
        if self._adapt is None or not self._before:
            return
        states = {
            name: frame.parse(given[name].state).value(codec(type_))
            for name, type_ in self._before.items()
            if given[name].state
        }
        (parameter,) = _hints(self._adapt)[0]
        after = self._adapt(parameter(**states))
        with runner.at_rest():
            runner.component.restore(getattr(after, runner.spec.name))


def _fetch(channel: Channel, asked: Future[StateTransfer]) -> None:
    try:
        asked.set_result(state_sender.fetch(channel, Ask.ALL, ASK_LIMIT))
    except Exception as error:  # noqa: BLE001, whoever takes over raises it
        asked.set_exception(error)


def types_of(
    adapt: Callable[[Any], Any],
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return which states a function takes, and which it gives: component -> type.

    Raises
    ------
    UsageError
        Its parameter or its result is not annotated with a message class.
    """
    parameters, result = _hints(adapt)
    found = []
    for type_ in (*parameters, result):
        if not (isinstance(type_, type) and issubclass(type_, msgspec.Struct)):
            raise UsageError(
                f"{adapt.__qualname__}: its parameter and its result must be message "
                "classes with a field for each component whose state it takes or gives"
            )
        fields = msgspec.structs.fields(type_)
        hints = get_type_hints(type_)
        found.append({field.name: hints[field.name] for field in fields})
    if len(found) != 2:  # noqa: PLR2004, one in, one out
        raise UsageError(f"{adapt.__qualname__} must take one argument: the old states")
    return found[0], found[1]


def _hints(adapt: Callable[[Any], Any]) -> tuple[tuple[Any, ...], Any]:
    hints = get_type_hints(adapt)
    names = tuple(inspect.signature(adapt).parameters)
    return tuple(hints.get(name) for name in names), hints.get("return")
