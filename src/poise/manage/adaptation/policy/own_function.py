"""A policy's own function, from the manager's side: it never waits for it."""

from __future__ import annotations

import select
import signal
import socket
import subprocess
import sys

from poise.errors import PoiseError
from poise.manage.adaptation.policy import function_process
from poise.manage.adaptation.policy.function_process import (
    IMPORT_LIMIT,
    LIMIT,
    FunctionAnswer,
)
from poise.model.policy.seen import PolicyAction, Seen
from poise.wire import record_channel

_AGAIN, _LONGEST = 10.0, 300.0
"""A process that ended is started again after this time [s]; then after twice that."""
_MARGIN = 0.5
"""The process has had time to end by itself, which says more [s]."""


class OwnFunction:
    """Asks a function what to do. All times are of one clock [s].

    Parameters
    ----------
    reference
        ``package.module:function``.
    folder
        Where that is imported from.

    Attributes
    ----------
    trouble
        What is wrong with it, for people; empty: nothing.
    """

    def __init__(self, reference: str, folder: str) -> None:
        self._reference = reference
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._actions: tuple[PolicyAction, ...] = ()
        self._asked_at: float | None = None
        self._limit = IMPORT_LIMIT
        self._start_at = float("-inf")
        self._again = _AGAIN
        self.trouble = ""

    def ask(self, seen: Seen) -> tuple[PolicyAction, ...]:
        """Return what it said last; ask it again, if it has answered by now."""
        try:
            self._hear()
            self._ask(seen)
        except (PoiseError, OSError) as error:
            self._end(str(error), seen.at)
        return self._actions

    def answer(self, seen: Seen) -> tuple[PolicyAction, ...]:
        """Ask it, and wait for what it says to this."""
        self.ask(seen)
        if self._asked_at is not None:
            select.select([self._connection], [], [], self._limit + _MARGIN)
        try:
            self._hear()
        except (PoiseError, OSError) as error:
            self._end(str(error), seen.at)
        return self._actions

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._connection.close()
            self._process = None

    def _ask(self, seen: Seen) -> None:
        if self._process is None and seen.at >= self._start_at:
            self._start()
        if self._process is None:
            return
        if self._asked_at is None:
            record_channel.send(self._connection, seen)
            self._asked_at = seen.at
        elif seen.at - self._asked_at > self._limit + _MARGIN:
            self._end(f"did not answer within {self._limit:g} s", seen.at)

    def _hear(self) -> None:
        if self._asked_at is None:
            return
        answer = self._reader.next(FunctionAnswer)
        if answer is None:
            return
        self._asked_at, self._limit = None, LIMIT
        self._actions = answer.actions
        if not answer.error:
            self._again = _AGAIN
        self.trouble = answer.error and f"'{self._reference}' failed: {answer.error}"

    def _start(self) -> None:
        self._connection, theirs = socket.socketpair()
        self._reader = record_channel.RecordReader(self._connection)
        with theirs:
            words = (self._reference, self._folder, str(theirs.fileno()))
            self._process = subprocess.Popen(  # noqa: S603, our own code and Python
                [sys.executable, "-m", function_process.__name__, *words],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is for the manager
            )
        self._asked_at, self._limit = None, IMPORT_LIMIT

    def _end(self, why: str, now: float) -> None:
        """Kill its process, and start another one later."""
        process = self._process
        self._actions, self._asked_at = (), None
        self._start_at, again = now + self._again, self._again
        self._again = min(2 * self._again, _LONGEST)
        if process is not None:
            process.kill()
            if process.wait() == -signal.SIGALRM:
                limits = f"{LIMIT:g} s, and {IMPORT_LIMIT:g} s for its import"
                why = f"took too long and was ended: its limit is {limits}"
            self._connection.close()
            self._process = None
        again_in = f"it is asked again in {again:g} s"
        self.trouble = f"'{self._reference}' {why}; {again_in}"
