"""The ways from a sender to its target: the seam, and direct invocation."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from poise.errors import CalleeError, CannotCross, Unavailable, said
from poise.runtime import _calls
from poise.runtime.component.error_report import traceback_of
from poise.runtime.component.ports import Port
from poise.runtime.connectors.interface import Method, as_declared, message_tag
from poise.runtime.connectors.latest import NONE, Heard, Number, take
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.exclusion import Exclusion
from poise.wire.records.deployment_records import ConnectorSpec

if TYPE_CHECKING:
    from poise.runtime.connectors.endpoints import ComponentEndpoints
    from poise.runtime.connectors.sender import Sender

_UNFIT = "(): incompatible function arguments."
"""What nanobind says where arguments do not fit the types in C++."""


class Route(Protocol):
    """A way to one incarnation of the target; by default one in this process."""

    def try_connect(self) -> bool:
        """Connect if needed; return at once whether the other end is there."""
        return True

    @property
    def refusal(self) -> str:
        """Why another computer was not reached last, if it is known."""
        return ""

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        """Return the function that calls a method of the target."""
        ...

    def is_calling(self) -> bool:
        """Return at once whether a call waits for an answer from another container."""
        return False

    def push(self, method: Method | None, value: object) -> int:
        """Send a message, or a one-way call of `method`; return its size [bytes]."""
        ...

    def has_room(self) -> bool:
        """Return at once whether the target has room for one more message."""
        ...

    def ask(self) -> Number | None:
        """Ask for room, in case that a credit got lost; raises as `push`.

        Return which numbered message the target got last; None: it says so later.
        """
        return None

    def send_marker(self, number: int) -> None:
        """Send a marker behind all that was pushed; raises as `push`."""
        ...

    def give_up(self) -> None:
        """Wait no more for a computer that is cut off, also in a `push` under way."""
        return

    def close(self) -> None:
        """Release its resources at once; harmless when repeated."""
        return


class DirectRoute(Route):
    """A way to a component in this process."""

    def __init__(
        self,
        spec: ConnectorSpec,
        target: ComponentEndpoints,
        port: Port,
        sender: Sender,
    ) -> None:
        self._connector, self._epoch = spec.name, spec.source_epoch
        self._target = target
        self._limit = spec.limit
        self._port = port.name
        self._feed = target.mailbox.feed(port.name, sender.counts)
        self._feed.on_room = sender.note_room
        self._tag = message_tag(port.type)

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        """Return a function that calls a method in this process."""

        def resend(*args: object, **kwargs: object) -> Any:  # noqa: ANN401, the call's
            if self._target.failure:
                sender.counts.add_call(0.0, failed=True)
                raise Unavailable(self._target.failure)
            deadline = time.monotonic() + self._limit
            return sender.repeat_call(self, method.name, args, kwargs, deadline)

        run = as_declared(getattr(self._target.component, method.name), method)
        if sender.chains is not None:
            run = sender.chains.direct(run, self._target.ages)
        exclusion, limit = self._target.exclusion, self._limit
        return direct_call(run, exclusion, limit, sender.counts, resend)

    def push(self, method: Method | None, value: object) -> int:
        """Put a message or one-way call into the target's mailbox."""
        if not self._is_overtaken():
            self._feed.put((method.tag if method else self._tag, value))
        return 0

    def _is_overtaken(self) -> bool:
        """Drop and count a message when a later incarnation has sent.

        A thread of a component's own may still publish where the component moved away.
        """
        is_overtaken = self._target.overtaken.note(self._connector, self._epoch)
        if is_overtaken:
            self._feed.counts.drops += 1
        return is_overtaken

    def has_room(self) -> bool:
        """Return whether the target's queue has room."""
        return self._feed.has_room()

    def send_marker(self, number: int) -> None:
        """Note at the target that all has come."""
        self._target.note_marker(self._connector, number)


class NumberedRoute(DirectRoute):
    """Such a way for numbered messages."""

    def push(self, method: Method | None, value: object) -> int:
        """Put a message into the target's mailbox, unless it has come before."""
        del method
        if not self._is_overtaken():
            take(self._heard, self._connector, value, self._put)
        return 0

    def ask(self) -> Number:
        """Return which message the target got last."""
        return self._heard.get(self._connector, NONE)

    @property
    def _heard(self) -> Heard:
        return self._target.heard[self._port]

    def _put(self, message: object) -> None:
        self._feed.put((self._tag, message))


def direct_call(
    method: Callable[..., Any],
    exclusion: Exclusion,
    limit: float,
    counts: Counts,
    resend: Callable[..., Any] | None = None,
) -> Callable[..., Any]:
    """Return a function that calls a method here; a late result is a `Timeout`."""
    return _calls.direct_call(
        method, exclusion, limit, counts, raise_callee_error, resend
    )


def raise_callee_error(error: BaseException) -> NoReturn:
    """Raise what a caller gets when its callee raised `error`, or was not called."""
    text = said(error)
    if error.__traceback__ is None and _UNFIT in text:
        method = text.partition("1. ")[2].partition("\n")[0]
        given = text.rpartition("types: ")[2]
        raise CannotCross(
            f"{method}, in C++, does not take what was given ({given}): an integer may "
            "be too large for its type, or a text may be no UTF-8"
        ) from error
    raise CalleeError(type(error).__qualname__, text, traceback_of(error)) from error
