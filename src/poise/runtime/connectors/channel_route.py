"""The route between containers: the same calls and messages, over a channel."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NoReturn

from msgspec import Struct

from poise.errors import (
    CalleeError,
    CallError,
    CannotCross,
    Sparing,
    Timeout,
    Unavailable,
    said,
)
from poise.runtime._calls import ServedCall, call_remote, time_left
from poise.runtime.component.error_report import traceback_of
from poise.runtime.component.ports import Port
from poise.runtime.connectors.endpoints import ComponentEndpoints
from poise.runtime.connectors.flow_control import Credit, CreditIssuer
from poise.runtime.connectors.interface import Method, message_tag, methods
from poise.runtime.connectors.latest import numbered, numbered_tag, take
from poise.runtime.connectors.route import raise_callee_error
from poise.runtime.connectors.sender import Sender
from poise.runtime.execution.container_lease import LeaseEnd, LeaseEnded, check_lease
from poise.runtime.execution.data_age import (
    RemoteClock,
    Stamped,
    served,
    stamped_value,
    with_stamps,
)
from poise.runtime.execution.exclusion import Redirected, current_chain
from poise.runtime.execution.mailbox import Feed
from poise.wire import frame
from poise.wire.codec import Codec, WireError, codec
from poise.wire.connections import connection
from poise.wire.connections.channel import Channel, Closed
from poise.wire.connections.connection_server import Handler
from poise.wire.frame import Frame, FrameKind, Pieces, segments, size_of
from poise.wire.records.deployment_records import ConnectorSpec

log = logging.getLogger(__name__)

_NOTHING: Codec[None] = Codec(type(None))

# looking a member up costs as much as a call
_CALL, _RESULT, _MARK, _MOVED = (
    FrameKind.CALL,
    FrameKind.RESULT,
    FrameKind.MARKER,
    FrameKind.MOVED,
)
_ERROR = FrameKind.ERROR
_LONGEST = 1e9
"""The longest limit that a frame holds [s]."""


class ChannelRoute:
    """A way to a component in another container."""

    def __init__(
        self,
        spec: ConnectorSpec,
        port: Port,
        channel: Channel,
        credit: Credit,
        remote_clock: RemoteClock,
        lease: LeaseEnd | None,
    ) -> None:
        self._channel = channel
        self.try_connect, self.is_calling = channel.try_connect, channel.is_calling
        self.give_up, self.close = channel.give_up, channel.close
        self.has_room = credit.has_room
        self._source = spec.source
        self._lease = lease
        self._remote_clock = remote_clock
        self._limit = spec.limit
        self._credit = credit
        self._is_topic = port.kind == "publishes"
        self._tag = message_tag(port.type)
        self._codec = codec(port.type) if self._is_topic else _NOTHING
        if port.latest:
            self._tag, self._codec = numbered_tag(port.type), numbered(self._codec)

    @property
    def refusal(self) -> str:
        """Why another computer was not reached last, if it is known."""
        return self._channel.refusal

    def push(self, method: Method | None, value: object) -> int:
        """Send a message or one-way call."""
        check_lease(self._lease, self._source)
        if method is None:
            kind, tag, coder = FrameKind.MESSAGE, self._tag, self._codec
        else:
            kind, tag, coder = FrameKind.ONEWAY, method.tag, method.arguments
        if type(value) is Stamped:
            coder = with_stamps(coder, value.chains)
            value = value.stamps, value.value
        credit = self._credit
        pieces = segments(
            coder, value, kind, tag=tag, number=credit.sent + 1, chain=credit.route
        )
        self._channel.push(pieces, self._limit, credit.note_sent)
        return size_of(pieces)

    def ask(self) -> None:
        """Request credit, behind all that went out."""
        self._channel.push(self._credit.request(), self._limit)

    def send_marker(self, number: int) -> None:
        """Send a marker."""
        pieces = segments(_NOTHING, None, _MARK, number=number)
        self._channel.push(pieces, self._limit)

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        """Return a function that calls a method in another container."""
        request, limit, counts = self._channel.request, self._limit, sender.counts
        name, clock = sender.name, self._remote_clock
        source, lease = self._source, self._lease
        bind, arguments, tag = method.bind, method.arguments, method.tag
        decode = method.result.decode
        if sender.chains is not None:
            chains = sender.chains
            bind, arguments = (
                chains.binding(bind),
                with_stamps(arguments, chains.carries),
            )
            result = with_stamps(method.result, chains.answers)
            decode = chains.taking(result.decode, clock)

        def call(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401, the method's own
            check_lease(lease, source)
            started = time.monotonic()
            chain, left = current_chain(), time_left(limit)
            if left <= 0.0:
                counts.add_call(0.0, failed=True)
                raise Timeout(
                    f"connector {name}: the call was not made: no time is left"
                )
            try:
                values = bind(*args, **kwargs)
            except TypeError as error:  # as within a container
                counts.add_call(0.0, failed=True)
                raise_callee_error(TypeError(f"{method.name}(): {error}"))
            waits = int(1e9 * min(left, _LONGEST)) or 1  # 0 were no limit
            answer: Frame | None = None
            pieces: Pieces = []
            try:
                pieces = segments(
                    arguments, values, _CALL, tag=tag, number=waits, chain=chain
                )
                answer = call_remote(chain, left, name, request, pieces)
                if answer.kind is _RESULT:
                    result = decode(answer.body, answer.buffers)
                elif answer.kind is not _MOVED:
                    _raise_failure(answer)
            except Closed:
                pass
            except (CallError, WireError) as error:
                came = answer.size if answer is not None else 0
                took = time.monotonic() - started
                sent = size_of(pieces) if pieces else 0
                counts.add_call(took, sent, came, failed=True)
                raise _told(error, f"{method.name} over {name}", left) from None
            if answer is None or answer.kind is _MOVED:  # it was not run
                deadline = started + left
                return sender.repeat_call(self, method.name, args, kwargs, deadline)
            took = time.monotonic() - started
            latency = answer.age + clock.offset
            size = size_of(pieces)
            counts.add_call(took, size, answer.size, latency, clock.error)
            return result

        return call


def _told(error: CallError | WireError, call: str, limit: float) -> CallError:
    """Return the error that a caller gets for a call that failed."""
    if isinstance(error, Timeout):
        return Timeout(f"{call}, limit {limit:.3g} s: {error}")
    if isinstance(error, WireError):
        return CannotCross(f"{call}: {error}")
    return error


class ReceivingEnd(Struct, frozen=True, kw_only=True):
    """The end of a connector at which frames come in; what comes waits in `feed`."""

    spec: ConnectorSpec
    target: ComponentEndpoints
    port: Port
    feed: Feed
    issuer: CreditIssuer
    remote_clock: RemoteClock
    lease: LeaseEnd | None = None

    def handler(self) -> Handler:
        """Return the handler of the frames that come in."""
        spec, target, port, feed = self.spec, self.target, self.port, self.feed
        clock, issuer, counts = self.remote_clock, self.issuer, feed.counts
        connector, coders = spec.name, _coders(port)
        text = "connector %s: refused: %s"
        tell = partial(Sparing(log).warn, "refused", text, connector)
        serve = self._serving(tell)
        read = partial(stamped_value, spec, clock) if spec.carries else Frame.value
        number_tag = numbered_tag(port.type) if port.kind == "subscribes" else None
        heard = target.heard[port.name]

        def put(message: object) -> None:
            feed.put((message_tag(port.type), message))

        def handle(received: Frame) -> Pieces | None:
            if received.kind is _MARK:
                target.note_marker(connector, received.number)
                return None
            if received.kind is _CALL:
                return serve(received)
            try:
                if received.kind is FrameKind.CREDIT_REQUEST:
                    issuer.requested(received, connection.current_connection())
                    return None
                latency = received.age + clock.offset
                counts.add_message(0, received.size, latency, clock.error)
                issuer.came(received)
                if target.overtaken.note(connector, spec.source_epoch):
                    counts.drops += 1
                    tell(f"one of a later incarnation of '{spec.source}' has come")
                    return None
                value = read(received, coders.get(received.tag) or _refuse(port))
                if received.tag == number_tag:
                    take(heard, connector, value, put)
                else:
                    feed.put((received.tag, value))
            except WireError as error:
                counts.refuse()
                tell(error)
            return None

        return handle

    def _serving(self, tell: Callable[[object], object]) -> Callable[[Frame], Pieces]:
        """Return a function that answers calls."""
        port, target = self.port, self.target
        clock, counts = self.remote_clock, self.feed.counts
        answers = {
            tag: self._answering(method) for tag, method in _methods(port).items()
        }

        def serve(received: Frame) -> Pieces:
            began = time.monotonic()
            try:
                answered = answers.get(received.tag) or _refuse(port)
                answer = answered(received, clock.most)
            except Redirected:
                if not target.failure:  # the call counts where it is run
                    return segments(_NOTHING, None, _MOVED)
                answer = _failure(Unavailable(target.failure))
            except (CalleeError, LeaseEnded, Timeout, WireError) as error:
                if isinstance(error, WireError):
                    tell(error)
                answer = _failure(error)
            except KeyboardInterrupt as error:  # the callee's: this is no main thread
                answer = frame.failure(
                    type(error).__name__, said(error), traceback_of(error)
                )
            took, failed = time.monotonic() - began, answer[0][1] == _ERROR
            size, latency = size_of(answer), received.age + clock.offset
            counts.add_call(took, size, received.size, latency, clock.error, failed)
            return answer

        return serve

    def _answering(self, method: Method) -> ServedCall:
        """Return what answers the calls of a method."""
        spec, target = self.spec, self.target
        arguments, result, tag = method.arguments, method.result, method.tag
        run = target.timing(getattr(target.component, method.name), spec.name)
        if spec.carries or spec.answers:
            arguments = with_stamps(arguments, spec.carries)
            result = with_stamps(result, spec.answers)
            run = served(run, target.ages, spec, self.remote_clock)

        def encode(value: object) -> Pieces:
            try:
                return segments(result, value, _RESULT, tag=tag)
            except WireError as error:  # the callee did not raise it
                return _failure(
                    WireError(f"it was called, but its result is lost: {error}")
                )

        return ServedCall(
            decode=arguments.decode,
            method=run,
            encode=encode,
            exclusion=target.exclusion,
            limit=spec.limit,
            counts=self.feed.counts,
            translate=raise_callee_error,
            is_over=connection.is_gone,
            lease=self.lease,
        )


def entry_codec(port: Port, tag: int) -> Codec[Any]:
    """Return the codec of a waiting message or one-way call, by its tag."""
    if port.kind == "subscribes":
        return codec(port.type)
    return _coders(port).get(tag) or _refuse(port)


def _coders(port: Port) -> dict[int, Codec[Any]]:
    """Return the codecs of messages or arguments of calls to a port, by their tags."""
    if port.kind == "subscribes":
        coder = codec(port.type)
        return {
            message_tag(port.type): coder,
            numbered_tag(port.type): numbered(coder),
        }
    return {tag: method.arguments for tag, method in _methods(port).items()}


def _methods(port: Port) -> Mapping[int, Method]:
    return methods(port.type) if port.kind == "provides" else {}


def _refuse(port: Port) -> NoReturn:
    raise WireError(
        f"port '{port.name}' ({port.type.__qualname__}) accepts nothing with this "
        "tag: its ends were built from different versions"
    )


def _raise_failure(answer: Frame) -> NoReturn:
    type_name, message, text = answer.value(frame.FAILURE)
    if not text and type_name == "Timeout":
        raise Timeout(message)
    if not text and type_name == "Unavailable":
        raise Unavailable(message)
    if not text and type_name == "WireError":
        raise WireError(f"the other end says: {message}")
    error = CalleeError(type_name, message, text)
    error.add_note(f"Raised in the callee:\n{text}")
    raise error


def _failure(error: CalleeError | Timeout | Unavailable | WireError) -> Pieces:
    if isinstance(error, CalleeError):
        return frame.failure(error.type_name, error.message, error.traceback)
    kind = Unavailable if isinstance(error, LeaseEnded) else type(error)
    return frame.failure(kind.__name__, str(error))
