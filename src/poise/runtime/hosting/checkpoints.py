"""Checkpoints of a component: its state, kept now and then where a crash spares it.

It gives a snapshot between its handlers; after a crash of its container the next
incarnation restores the file in the agent's folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from poise.clock import Clock, boot_time
from poise.errors import RunError
from poise.runtime.component.component import Component
from poise.runtime.connectors.latest import LatestMessages
from poise.runtime.execution.container_lease import LeaseEnd, check_lease
from poise.runtime.migration.state_check import check_fits, describe_type, type_taken_by
from poise.user_folders import write_private
from poise.wire import frame
from poise.wire.codec import Codec, WireError, codec
from poise.wire.frame import FrameKind
from poise.wire.records.request_records import (
    MOST_KEPT,
    age_of,
    checkpoint_path,
    set_age,
)


class _Checkpoint(Struct, frozen=True):
    """A state as a frame, with its type by `describe_type`; empty: there is none."""

    state_type: str
    state: bytes
    latest: Mapping[str, bytes] = {}  # Port -> its last message


_REMEDY = (
    "let `poise replace` bring back code that takes the state of the checkpoint, or "
    "drop it with --fresh"
)
_CHECKPOINT: Codec[_Checkpoint] = codec(_Checkpoint)


class Checkpoints:
    """Takes and restores the checkpoints of one component, on its own thread."""

    def __init__(
        self,
        folder: Path,
        component: str,
        epoch: int,
        every: float,
        clock: Clock,
        lease: LeaseEnd | None = None,
    ) -> None:
        self._path = checkpoint_path(folder, component, epoch)
        self._every = every
        self._clock = clock
        self._lease = lease
        self._component = component
        self._before = b""
        self.due = float("inf")
        self.cost = 0.0

    def postpone(self) -> None:
        """Be due after an interval."""
        self.due = self._clock.now() + self._every

    def write(self, component: Component, latest: LatestMessages) -> None:
        """Keep the state of a component; when that fails, the one before is kept."""
        began = self._clock.now()
        self.postpone()
        state, last = component.snapshot(), latest.to_frames()
        if state is None and not last:
            return
        checkpoint = _Checkpoint("", b"", last)
        if state is not None:
            pieces = frame.segments(codec(type(state)), state, FrameKind.MESSAGE)
            described = describe_type(type(state))
            checkpoint = _Checkpoint(described, b"".join(pieces), last)
        data = b"".join(frame.segments(_CHECKPOINT, checkpoint, FrameKind.RECORD))
        if len(data) > MOST_KEPT:
            raise RunError(
                f"its state of {len(data) / 2**20:.0f} MiB is too large for a "
                f"checkpoint: {MOST_KEPT >> 20} MiB are the limit"
            )
        if state is not None and data != self._before:
            # one that could not be restored would replace one that can
            frame.parse(checkpoint.state).value(codec(type(state)))
        check_lease(self._lease, self._component)
        if data != self._before or not self._is_renewed():
            write_private(self._path, data, boot_time())
            self._before = data
        self.cost = self._clock.now() - began
        if self.cost > self._every:
            raise RunError(
                f"the checkpoint took {self.cost:.2f} s, longer than its interval of "
                f"{self._every:g} s: make the state smaller, or the interval longer"
            )

    def _is_renewed(self) -> bool:
        """Let the one before be as old as this moment; return whether it is there."""
        try:
            set_age(self._path)
        except FileNotFoundError:
            return False
        return True

    def restore(self, component: Component, latest: LatestMessages) -> float | None:
        """Restore the state that was kept; return its age [s], None: there is none."""
        try:
            data = self._path.read_bytes()
            age = age_of(self._path.stat().st_mtime)
            kept: _Checkpoint = frame.parse(data).value(_CHECKPOINT)
            state = _state_in(kept, component) if kept.state else None
        except FileNotFoundError:
            return None
        except (OSError, WireError) as error:
            what = f"its checkpoint {self._path} cannot be read: {error}"
            raise RunError(f"{what}; `poise replace` with --fresh drops it") from None
        if kept.state:
            component.restore(state)
        latest.restore(kept.latest)
        self._before = data
        return age


def _state_in(kept: _Checkpoint, component: Component) -> Any:  # noqa: ANN401, a user's type
    taken = type_taken_by(component.restore)
    by = type(component).restore.__qualname__
    check_fits(kept.state_type, taken, by, _REMEDY)
    return frame.parse(kept.state).value(codec(taken))
