"""Frames to send over pipes, and a handler that answers them."""

from __future__ import annotations

import threading

from poise.wire import frame
from poise.wire.codec import codec
from poise.wire.frame import Frame, Kind
from poise.wire.pipe import Pieces

TEXT = codec(str)
LIMIT = 20.0
"""Far longer than anything here takes [s]."""
SHORT = 0.02
"""For what must run into its limit [s]."""


def call(text: str) -> Pieces:
    return frame.segments(TEXT, text, Kind.CALL)


def message(text: str) -> Pieces:
    return frame.segments(TEXT, text, Kind.MESSAGE)


class Receiver:
    """Answers calls with what they say, backwards, and keeps messages."""

    def __init__(self) -> None:
        self.messages: list[str] = []
        self.came = threading.Condition()

    def __call__(self, received: Frame) -> Pieces | None:
        text = received.value(TEXT)
        if received.kind is Kind.CALL:
            return frame.segments(TEXT, text[::-1], Kind.RESULT)
        with self.came:
            self.messages.append(text)
            self.came.notify_all()
        return None

    def wait_for(self, count: int) -> list[str]:
        with self.came:
            assert self.came.wait_for(lambda: len(self.messages) >= count, LIMIT)
            return self.messages
