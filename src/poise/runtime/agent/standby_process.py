"""The process that waits on an agent's computer to lead its robot, should nobody."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import termios
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.msgpack import encode

from poise.errors import PoiseError
from poise.user_folders import write_private
from poise.wire.address import KEYS
from poise.wire.records.request_records import Claim

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

_COMMAND = sys.executable, "-m", "poise", "standby"
_INT = 4
"""The size of what the kernel answers [bytes]."""


class StandbyProcess:
    """The `StandbyControl` of a real computer; ends with the agent, unless it leads."""

    def __init__(self, computer: str, folder: Path, keys: Credentials | None) -> None:
        self._computer = computer
        self._keys = keys  # the agent's, above those to lead with
        self._path = folder / "claim"
        self._kept: Claim | None = None
        self._failure = ""
        self._written: tuple[object, object] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def keep(self, claim: Claim | None) -> None:
        """Let one wait that would lead as this claim says; None: none waits."""
        has_ended = self._process is not None and self._process.poll() is not None
        if claim == self._kept and not has_ended:
            return
        self._kept, self._failure = claim, ""
        if claim is None or not self._has_keys():
            self._tell(b"end\n")
            return
        try:
            self._wait_with(claim, has_ended=has_ended)
        except OSError as error:
            self._kept = None  # it is tried again
            self._failure = f"no standby waits here: {error}; this is tried again"

    def _wait_with(self, claim: Claim, *, has_ended: bool) -> None:
        robot = claim.agents, claim.election  # all that a standby looks at
        if robot != self._written:
            write_private(self._path, encode(claim))
            self._written = robot
        if self._process is None or has_ended:
            self._process = subprocess.Popen(  # noqa: S603, Poise itself
                [*_COMMAND, self._computer, "--claim", str(self._path)],
                stdin=subprocess.PIPE,
                start_new_session=True,
                env={**os.environ, KEYS: str(self._keys.to_lead) if self._keys else ""},
            )

    def notice(self) -> str:
        """Return why the one that waits cannot lead, or soon cannot; or nothing."""
        if self._failure or self._kept is None or self._keys is None:
            return self._failure
        if not self._has_keys():
            return (
                "no standby waits here, for it has no keys to lead with in "
                f"{self._keys.to_lead}: `poise keys issue --leads` makes them"
            )
        try:
            return self._keys.leading().warning()
        except (PoiseError, OSError) as error:
            return f"the standby here cannot lead: {error}"

    def _has_keys(self) -> bool:
        return self._keys is None or self._keys.to_lead.is_dir()

    def lead(self) -> None:
        """Let it become the leader, if it can; harmless while it does."""
        if not self._has_unread():  # it may be busy with that for long
            self._tell(b"lead\n")

    def _has_unread(self) -> bool:
        process = self._process
        if process is None or process.stdin is None:
            return False
        return any(fcntl.ioctl(process.stdin, termios.FIONREAD, bytes(_INT)))

    def _tell(self, what: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError):  # it has ended
                os.write(self._process.stdin.fileno(), what)
