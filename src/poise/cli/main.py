"""Where `poise` begins: first with what Ctrl-C does, then with all that takes time."""

from __future__ import annotations

import signal
import sys
from types import FrameType

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> None:
    """Run the command line.

    Exit codes: 0 done; 1 the robot, its file or its run has a problem; 2 used
    wrongly; 128 + n ended by signal n, such as 130 by Ctrl-C.
    """
    for number in _ENDING:
        signal.signal(number, _end)
    from poise.cli.commands import run

    run()


def _end(number: int, _frame: FrameType | None) -> None:
    """Leave by way of every clean-up; a second signal must not cut that short."""
    for each in _ENDING:
        signal.signal(each, signal.SIG_IGN)
    sys.exit(128 + number)
