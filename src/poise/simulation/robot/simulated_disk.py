"""An agent's folder on a simulated disk, which may be slow or full."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from poise.runtime.agent.surroundings import AgentState, Reply
from poise.simulation.robot.simulated_process import Process, SimulatedComputer
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.request_records import (
    Accepted,
    CheckpointCopy,
    OutputLines,
    ReadOutput,
    Refused,
)

_SEND_WITHIN = 0.1
Key = tuple[str, int]


class SimulatedDisk:
    """The `AgentDisk` of a simulated computer; it outlives its agents.

    `left`: what an agent has kept, as far as it was written before it was killed.
    `is_full`: whether nothing can be written: a fault.
    `delay`: how long each write takes [s]: a fault makes it long.
    """

    def __init__(self, computer: SimulatedComputer) -> None:
        self.left = AgentState()
        self.is_full = False
        self.delay = 0.001
        self._computer = computer
        self._kept = self.left
        self._wanted: tuple[Key, ...] = ()
        self._checkpoints: dict[Key, tuple[float, bytes]] = {}
        self._sent: dict[Key, float] = {}
        self._send: Callable[[CheckpointCopy], object] = lambda _: None
        self._is_sending = False

    def begin(self, process: Process, send: Callable[[CheckpointCopy], object]) -> None:
        """Serve another agent."""
        self._process, self._send, self._sent = process, send, {}
        self._kept = self.left
        self._is_sending = False
        self._send_soon()

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed."""
        if state != self._kept:
            self._kept = state
            self._process.after(self.delay, lambda: self._keep(state))

    def forget(self) -> None:
        """Leave nothing to the next agent."""
        self.keep(AgentState())

    def serve(self, request: ReadOutput | CheckpointCopy, reply: Reply) -> None:
        """Write a checkpoint, or read output, of which there is none."""
        if isinstance(request, ReadOutput):
            reply(OutputLines())
        elif self.is_full:
            reply(Refused("it cannot use its folder: no space left on device"))
        else:
            self._write(lambda: self._store(request))
            self._process.after(self.delay, lambda: reply(Accepted()))

    def keep_only(self, wanted: Deployment) -> None:
        """Remove the checkpoints of all that is not wanted, and send the others."""
        components = [c for each in wanted.containers for c in each.components]
        kept = {(c.name, c.epoch) for c in components}
        self._checkpoints = {k: v for k, v in self._checkpoints.items() if k in kept}
        self._wanted = tuple((c.name, c.epoch) for c in components if c.checkpoint)
        self._send_soon()

    def resend(self) -> None:
        """Send all checkpoints again."""
        self._sent = {}
        self._send_soon()

    def checkpoint_age(self, component: str, epoch: int) -> float | None:
        """Return how old the last checkpoint is [s]; None: there is none."""
        at, _ = self._checkpoints.get((component, epoch), (None, b""))
        return None if at is None else self._computer.boottime() - at

    def trouble(self) -> str:
        """Return what is wrong with it."""
        return "no space left on device" if self.is_full else ""

    def save(self, component: str, epoch: int, data: bytes) -> None:
        """Keep a checkpoint that a container took."""
        if not self.is_full:
            self._checkpoints[component, epoch] = self._computer.boottime(), data
            self._send_soon()

    def _keep(self, state: AgentState) -> None:
        if self.is_full:  # better nothing than what holds no more; it is tried again
            state = self._kept = AgentState()
        self.left = state

    def _store(self, copy: CheckpointCopy) -> None:
        at = self._computer.boottime() - copy.age
        self._checkpoints[copy.component, copy.epoch] = at, copy.data or b""
        self._send_soon()

    def _write(self, act: Callable[[], object]) -> None:
        if not self.is_full:
            self._process.after(self.delay, act)

    def _send_soon(self) -> None:
        """Send copies of new checkpoints within a moment; of several one."""
        if not self._is_sending:
            self._is_sending = True
            self._process.after(_SEND_WITHIN, self._send_new)

    def _send_new(self) -> None:
        self._is_sending = False
        for key in self._wanted:
            at, data = self._checkpoints.get(key, (0.0, b""))
            if data and self._sent.get(key) != at:
                self._sent[key] = at
                age = self._computer.boottime() - at
                copy = CheckpointCopy(
                    component=key[0], epoch=key[1], data=data, age=age
                )
                self._process.spawn("checkpoint", partial(self._send, copy))
