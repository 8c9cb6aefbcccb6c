"""Carries the stamps of chains over connectors, beside messages, calls and answers.

Over a wire they stand before the value, 9 bytes each and 2 in all; both ends know from
the deployment which chains pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

from poise.runtime.execution.clocks import RemoteClock
from poise.runtime.execution.data_age import DataAges, Stamped
from poise.wire.codec import Codec, codec
from poise.wire.frame import Frame
from poise.wire.records.deployment_records import ConnectorSpec

Stamps = tuple[float, ...]


def with_stamps(coder: Codec[Any]) -> Codec[tuple[Stamps, Any]]:
    """Return the codec of values behind their stamps."""
    return codec(tuple[Stamps, coder.type], coder.name)  # type: ignore[name-defined]


class SentChains:
    """The source's end of the chains that pass over a connector."""

    def __init__(
        self, ages: DataAges, carries: Sequence[str], answers: Sequence[str]
    ) -> None:
        self._ages = ages
        self.carries = carries
        self._answers = answers

    def stamping(self, send: Callable[..., None]) -> Callable[..., None]:
        """Return `send` for messages and arguments of calls, with their stamps."""

        def stamp(value: object, method: object = None) -> None:
            send(self.stamped(value), method)

        return stamp

    def stamped(self, value: object) -> Stamped:
        """Return a value with its stamps."""
        return Stamped(self.carries, self._ages.stamps(self.carries), value)

    def binding(
        self, bind: Callable[..., tuple[Any, ...]]
    ) -> Callable[..., tuple[Any, ...]]:
        """Return a function that also puts stamps in front of a call's arguments."""

        def stamp(*args: Any, **kwargs: Any) -> tuple[Any, ...]:  # noqa: ANN401, a call's
            values = bind(*args, **kwargs)
            return self._ages.stamps(self.carries), values

        return stamp

    def taking(
        self, decode: Callable[..., tuple[Stamps, Any]], remote: RemoteClock
    ) -> Callable[..., Any]:
        """Return a function that decodes an answer and takes its stamps."""

        def take(*answer: object) -> Any:  # noqa: ANN401, the call's own
            stamps, result = decode(*answer)
            self._ages.take(self._answers, local(stamps, remote))
            return result

        return take

    def direct(
        self, method: Callable[..., Any], target: DataAges
    ) -> Callable[..., Any]:
        """Return a method of a target in the same process, which takes stamps, too."""

        @wraps(method)
        def run(*args: object, **kwargs: object) -> Any:  # noqa: ANN401, the call's own
            result = target.run(
                lambda *_: method(*args, **kwargs), (), taken=self.stamped(None)
            )
            self._ages.take(self._answers, target.stamps(self._answers))
            return result

        return run


def served(
    method: Callable[..., Any],
    ages: DataAges,
    spec: ConnectorSpec,
    remote: RemoteClock,
) -> Callable[[Stamps, Sequence[object]], tuple[Stamps, Any]]:
    """Return a target's method that takes stamps and answers with some."""

    def serve(stamps: Stamps, args: Sequence[object]) -> tuple[Stamps, Any]:
        taken = Stamped(spec.carries, local(stamps, remote), None)
        result = ages.run(method, args, taken=taken)
        return ages.stamps(spec.answers), result

    return serve


def stamped_value(
    spec: ConnectorSpec, remote: RemoteClock, received: Frame, coder: Codec[Any]
) -> Stamped:
    """Return what a message or one-way call holds, with its stamps."""
    stamps, value = received.value(with_stamps(coder))
    return Stamped(spec.carries, local(stamps, remote), value)


def local(stamps: Stamps, remote: RemoteClock) -> Stamps:
    """Return stamps of the other end's clock on this computer's."""
    return tuple(stamp - remote.ahead for stamp in stamps)
