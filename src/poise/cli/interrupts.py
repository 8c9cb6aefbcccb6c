"""What Ctrl-C, SIGTERM and SIGHUP do to a command. No handler raises anything."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import Self

_SHOW_CURSOR = b"\x1b[?25h"
"""Makes a terminal's cursor visible, which spinners and bars hide."""
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def end_at_once() -> None:
    """Let each signal end this process with its exit code: nothing has begun.

    SIGHUP stays ignored where it is, as under `nohup`.
    """
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, _frame: FrameType | None) -> None:
    if os.isatty(2):
        os.write(2, _SHOW_CURSOR)
    os._exit(128 + number)


class Interrupts:
    """Notes signals inside its ``with`` block, at whose end the command ends.

    `check` raises KeyboardInterrupt where the command waits. A second signal does
    nothing, as it must not cut clean-up short.
    """

    def __init__(self) -> None:
        self.number = 0

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self.number:
            raise KeyboardInterrupt

    def has_come(self) -> bool:
        """Return whether a signal came."""
        return self.number != 0

    def __enter__(self) -> Self:
        self._before = {number: signal.getsignal(number) for number in _ENDING}
        for number, handler in self._before.items():
            if handler != signal.SIG_IGN:
                signal.signal(number, self._note)
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self.number:
            raise SystemExit(128 + self.number) from error

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.number = self.number or number
