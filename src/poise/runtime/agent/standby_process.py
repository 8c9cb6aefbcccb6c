"""The process that waits on an agent's computer to lead its robot, should nobody."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

from msgspec.msgpack import encode

from poise.wire.records.request_records import Claim

_COMMAND = sys.executable, "-m", "poise", "standby"


class StandbyProcess:
    """The `StandbyControl` of a real computer.

    The process ends when the agent does, unless it leads.
    """

    def __init__(self, computer: str, folder: Path) -> None:
        self._computer = computer
        self._path = folder / "claim"
        self._kept: Claim | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def keep(self, claim: Claim | None) -> None:
        """Let one wait that would lead as this claim says; None: none waits."""
        has_ended = self._process is not None and self._process.poll() is not None
        if claim == self._kept and not has_ended:
            return
        self._kept = claim
        if claim is None:
            self._tell(b"end\n")
            return
        draft = self._path.with_suffix(".new")
        draft.write_bytes(encode(claim))
        draft.replace(self._path)
        if self._process is None or has_ended:
            self._process = subprocess.Popen(  # noqa: S603, Poise itself
                [*_COMMAND, self._computer, "--claim", str(self._path)],
                stdin=subprocess.PIPE,
                start_new_session=True,
            )

    def lead(self) -> None:
        """Let it become the leader, if it can; harmless while it does."""
        self._tell(b"lead\n")

    def _tell(self, what: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError):  # it has ended
                os.write(self._process.stdin.fileno(), what)
