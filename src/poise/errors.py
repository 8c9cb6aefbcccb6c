"""The errors that Poise raises, sorted by what a caller can do, and words for them.

::

    PoiseError
      UsageError        you called it wrongly: correct the call
      RobotError        the robot file or a problem is wrong: correct the file
      RunError          the world broke: a process, a computer or a link
        AlreadyManaged  another manager has the robot, and agents refuse this one
        TakenOver       another manager has the robot now, which goes on
        NoManager       the robot goes on, and no manager of it answers
        CallError       a call through a connector did not bring back a result
          Unavailable   nobody answers at the other end
          Timeout       the answer did not come within the connector's limit
          CannotCross   an argument or the result is not of its declared type
          CalleeError   the callee raised; its type, message and traceback are here
"""

from __future__ import annotations

import difflib
import logging
import re
import time
from collections.abc import Hashable, Iterable, Sequence
from itertools import islice
from math import inf
from signal import Signals

from msgspec import Struct

from poise.version import VERSION


class FileProblem(Struct, frozen=True, order=True):
    """One thing that is wrong in a file.

    `line` and `column` count from 1; a problem of the file as a whole has 0 in both.
    """

    file: str
    line: int
    column: int
    message: str

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}:{self.column}" if self.line else self.file
        return f"{where}: {self.message}"


class PoiseError(Exception):
    """Anything that Poise raises on purpose.

    `exit_code` is what a command ends with that it ends.
    """

    exit_code = 1


class UsageError(PoiseError):
    """A command or function was used wrongly; nothing was changed."""

    exit_code = 2


class RobotError(PoiseError):
    """A robot file, or what it describes, is wrong; nothing was started.

    Parameters
    ----------
    message
        What is wrong. Empty: the problems, one a line.
    problems
        Every problem that was found, when they lie in files.
    """

    def __init__(self, message: str = "", problems: Sequence[FileProblem] = ()) -> None:
        super().__init__(message or "\n".join(map(str, problems)))
        self.problems = tuple(problems)


class RunError(PoiseError):
    """Something in the running world broke: a process, a computer, a link."""


class AlreadyManaged(RunError):
    """Another manager has the robot, whose agents refuse this one; nothing changed."""

    exit_code = 3


class TakenOver(RunError):
    """Another manager has taken over the robot, which keeps running."""

    exit_code = 3


class CallError(RunError):
    """A call through a connector did not bring back a result."""


class Unavailable(CallError):
    """Nobody answers at the other end of a connector."""


class CannotCross(CallError):
    """An argument or the result of a call is not of its declared type, or too large."""


class Timeout(CallError):
    """The answer did not come within the connector's time limit."""


class CalleeError(CallError):
    """The callee raised an error, wherever it runs.

    Parameters
    ----------
    type_name
        The qualified name of the callee's error class, such as ``"ValueError"``.
    message
        What ``str`` gave of the callee's error.
    traceback
        The callee's traceback as text, for people.
    """

    def __init__(self, type_name: str, message: str, traceback: str = "") -> None:
        super().__init__(f"{type_name}: {message}")
        self.type_name = type_name
        self.message = message
        self.traceback = traceback


_MOST = 12
"""More choices than this are not listed in a message."""
_MOST_COMPARED = 500
"""More choices than this are not compared with a name: it takes 10 us for each."""


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the closest choice, or nothing."""
    compared = list(islice(choices, _MOST_COMPARED))
    close = difflib.get_close_matches(str(word), compared, n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def listed(choices: Iterable[str]) -> str:
    """Return the choices as a list for people, shortened if it is long."""
    names = [f"'{choice}'" for choice in choices]
    if len(names) > _MOST:
        names = [*names[:_MOST], f"and {len(names) - _MOST} more"]
    return ", ".join(names) or "none"


def unknown(kind: str, word: str, choices: Iterable[str]) -> str:
    """Return the message for a name that is not in `choices`."""
    choices = tuple(dict.fromkeys(choices))
    return (
        f"there is no {kind} '{word}'{did_you_mean(word, choices)}; "
        f"{kind}s: {listed(choices)}"
    )


_MINOR = re.compile(r"(\d+)\.(\d+)(\.\w+)*")


def why_too_old(least: str) -> str:
    """Return why this Poise cannot read what needs a version; empty: it can.

    Only major and minor version count. ValueError: `least` is no version.
    """
    if _minor(least) <= _minor(VERSION):
        return ""
    return f"it needs Poise {least}, and this is {VERSION}: install the newer one"


def _minor(text: str) -> tuple[int, int]:
    found = _MINOR.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r} is not a valid version; one is 0.2")
    return int(found[1]), int(found[2])


def signal_name(number: int) -> str:
    """Return a signal for people; some have no name."""
    try:
        return Signals(number).name
    except ValueError:
        return f"signal {number}"


def encodable(text: str) -> str:
    """Return a text that can be sent: the name of a file may be any bytes."""
    return text.encode(errors="backslashreplace").decode()


def last_error(traceback: str) -> str:
    """Return type and first line of the error that a traceback ends with."""
    *earlier, last = traceback.rstrip().split("\n")
    frames = [n for n, line in enumerate(earlier) if line.startswith('  File "')]
    after = earlier[frames[-1] + 1 if frames else 0 :]
    # a frame has its code below
    heads = "  ", "Traceback"
    first = next((line for line in after if not line.startswith(heads)), "")
    return f"{first} ..." if first else last


def said(error: object) -> str:
    """Return what an error says as a text that can be sent, whatever its class does."""
    try:
        return encodable(str(error))
    except Exception:  # noqa: BLE001, a user's class may raise anything
        return f"<str() of a {type(error).__qualname__} failed>"


AGAIN = 10.0
"""What is like something that was logged is logged again after this time [s]."""


class Sparing:
    """Logs what may come a thousand times a second, one in `AGAIN` of those alike."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._logged: dict[Hashable, tuple[float, int]] = {}

    def warn(self, like: Hashable, text: str, *args: object) -> None:
        """Log a warning, unless one that is like it was logged lately."""
        more = self.more(like, time.monotonic())
        if more is not None:
            self._log.warning("%s%s", text % args, more)

    def more(self, like: Hashable, now: float) -> str | None:
        """Return how many came since the last logged one, in words; None: not now."""
        at, since = self._logged.get(like, (-inf, 0))
        if now - at < AGAIN:
            self._logged[like] = at, since + 1
            return None
        self._logged[like] = now, 0
        return f" ({since} more like it since the last)" if since else ""
