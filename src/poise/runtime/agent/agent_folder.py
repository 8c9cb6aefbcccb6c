"""The folder in which an agent keeps what the next one must know."""

from __future__ import annotations

import fcntl
import logging
import os
from pathlib import Path

import msgspec

from poise.clock import boot_id
from poise.errors import UsageError
from poise.runtime.agent.supervision.agent_state import AgentState
from poise.wire.records.requests import PROTOCOL

log = logging.getLogger(__name__)


class AgentFolder:
    """The folder of an agent, which one process uses at a time.

    Raises
    ------
    UsageError
        Another agent uses it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "state"
        self._lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o600)
        self._boot = boot_id()
        self._kept = AgentState()
        self.trouble = ""
        try:
            # a lock of this process alone: what it forks does not hold it
            fcntl.lockf(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise UsageError(
                f"another agent uses the folder {folder}: end that one, or choose "
                "another with --folder"
            ) from None

    def left(self) -> AgentState:
        """Return what an agent that was killed has kept here; nothing: as it began."""
        try:
            kept = msgspec.msgpack.decode(self._path.read_bytes(), type=AgentState)
        except FileNotFoundError:
            return AgentState()
        except (OSError, msgspec.DecodeError) as error:
            log.warning("what an earlier agent kept in %s: %s", self._path, error)
            return AgentState()
        is_valid = kept.boot == self._boot and kept.protocol == PROTOCOL
        return kept if is_valid else AgentState()

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed; `trouble` says why not."""
        state = msgspec.structs.replace(state, boot=self._boot)
        if state == self._kept:
            return
        new = self._path.with_suffix(".new")
        try:
            new.write_bytes(msgspec.msgpack.encode(state))
            new.replace(self._path)
        except OSError as error:
            self.forget()  # better nothing than what holds no more
            self._kept = AgentState()
            self.trouble = (
                f"the agent cannot keep what should run: {error}; if it is killed, the "
                "next one waits for its manager"
            )
        else:
            self._kept, self.trouble = state, ""

    def forget(self) -> None:
        """Leave nothing for the next agent."""
        self._path.unlink(missing_ok=True)
