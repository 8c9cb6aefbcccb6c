"""What Ctrl-C, SIGTERM and SIGHUP do to a command."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Self

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Ends a command on a signal: at once, or where nothing can be left half done.

    Inside its ``with`` block a signal is only noted: `check` raises it where the
    command waits; at the end of the block the command ends with its exit code. The
    second signal is ignored, as it must not cut clean-up short.
    """

    def __init__(self) -> None:
        self.number = 0
        self._is_noted_only = False

    def install(self) -> None:
        """Handle the signals from now on."""
        for number in _ENDING:
            signal.signal(number, self._on_signal)

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self.number:
            raise KeyboardInterrupt

    def __enter__(self) -> Self:
        self._is_noted_only = True
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self._is_noted_only = False
        if self.number:
            raise SystemExit(128 + self.number) from error

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        if self.number:
            return
        self.number = number
        if not self._is_noted_only:  # nothing has begun
            raise SystemExit(128 + number)


interrupts = Interrupts()
"""Those of this process."""
