"""The checkpoints of a computer's components, and the copies that its manager keeps.

A container writes each checkpoint into the agent's folder. A thread of the agent sends
those that changed to the manager, which keeps the last: so they outlive the container
and the computer.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from poise import threads
from poise.wire.records.checkpoints import (
    CheckpointCopy,
    age_of,
    checkpoint_path,
    set_age,
)
from poise.wire.records.deployment import Deployment

log = logging.getLogger(__name__)

LOOK_EVERY = 0.1
"""New checkpoints are looked for this often [s]."""
_JOIN_LIMIT = 1.0


class CheckpointFiles:
    """The checkpoints in the folder of an agent.

    Parameters
    ----------
    send
        Sends a copy to the manager; called on a thread of its own.
    """

    def __init__(self, folder: Path, send: Callable[[CheckpointCopy], object]) -> None:
        self._folder = folder
        self._send = send
        self._wanted: tuple[tuple[str, int], ...] = ()
        self._sent: dict[tuple[str, int], tuple[int, int]] = {}
        self._ended = threading.Event()
        self._has_work = threading.Event()
        self._modified: dict[tuple[str, int], float] = {}
        self._thread = threads.daemon(self._main, "checkpoints", again=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """Send no more."""
        self._ended.set()
        self._has_work.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_LIMIT)

    def send_only(self, wanted: Deployment) -> None:
        """Send the checkpoints of what is wanted from now on."""
        components = [c for each in wanted.containers for c in each.components]
        self._wanted = tuple((c.name, c.epoch) for c in components if c.checkpoint)
        if self._wanted:
            self._has_work.set()

    def remove_all_but(self, wanted: Deployment) -> None:
        """Remove the checkpoints of what is not wanted; raises OSError."""
        components = [c for each in wanted.containers for c in each.components]
        kept = {checkpoint_path(self._folder, c.name, c.epoch) for c in components}
        for path in set(self._folder.glob("*.checkpoint")) - kept:
            path.unlink(missing_ok=True)

    def resend(self) -> None:
        """Send all again: there is another manager."""
        self._sent = {}

    def write(self, copy: CheckpointCopy) -> None:
        """Keep a copy for a component that is to start here; raises OSError."""
        path = checkpoint_path(self._folder, copy.component, copy.epoch)
        path.write_bytes(copy.data or b"")
        set_age(path, copy.age)

    def age(self, component: str, epoch: int) -> float | None:
        """Return the age of a checkpoint [s]; None: there is none. No disk is used."""
        modified = self._modified.get((component, epoch))
        return None if modified is None else age_of(modified)

    def _main(self) -> None:
        self._has_work.wait()  # most robots have no checkpoints
        while not self._ended.wait(LOOK_EVERY):
            for copy in self._news():
                self._send(copy)

    def _news(self) -> Iterator[CheckpointCopy]:
        sent, self._sent = self._sent, dict(self._sent)
        self._modified = {k: v for k, v in self._modified.items() if k in self._wanted}
        for component, epoch in self._wanted:
            path = checkpoint_path(self._folder, component, epoch)
            with contextlib.suppress(OSError):  # there is none yet
                found = path.stat()
                at = found.st_ino, found.st_mtime_ns
                self._modified[component, epoch] = found.st_mtime
                before = sent.get((component, epoch))
                if at == before:
                    continue
                # the same file has the same content: only its age is news
                is_same = before is not None and before[0] == at[0]
                yield CheckpointCopy(
                    component=component,
                    epoch=epoch,
                    data=None if is_same else path.read_bytes(),
                    age=age_of(found.st_mtime),
                )
                self._sent[component, epoch] = at
