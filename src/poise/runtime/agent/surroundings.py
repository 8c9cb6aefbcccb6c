"""What an agent's logic needs of the world: time, processes, disk and network.

The agent gives `AgentCore` the real one; a simulator a modelled one in virtual time.
All methods are called on the agent's own thread and return soon, unless said otherwise.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from random import Random
from signal import Signals
from typing import Protocol

from msgspec import Struct

from poise.clock import Clock
from poise.runtime.container.account import Account
from poise.runtime.supervision.health import Usage
from poise.wire.control_session import SESSION_TIMEOUT
from poise.wire.heartbeats import Address, Hear, NextBeat
from poise.wire.records.code_records import CodePart, InstallCode
from poise.wire.records.deployment_records import ContainerSpec, Deployment
from poise.wire.records.request_records import (
    Answer,
    CheckpointCopy,
    Claim,
    ReadOutput,
    Versioned,
)
from poise.wire.records.status_records import SAMPLE_EVERY, AgentStatus, ToContainer

DEPLOYED = "deployed"
"""In `AgentSetup.allow`: the code that was sent by `poise deploy`."""
BROKEN = os.EX_SOFTWARE
"""The exit code of an agent that an error of Poise ended: start it again."""


class AgentSetup(Struct, frozen=True, kw_only=True):
    """Where an agent is and whom it knows."""

    robot: str
    computer: str
    address: str  # IP address on which it and its containers listen
    port: int = 7447  # TCP port of the agent
    # TCP port for connections from other computers to its containers; 0: a free one
    gateway: int = 0
    # A folder of its own for sockets; the same one when it is started again
    folder: str
    # A file descriptor at whose end of file the agent ends; None: it runs on
    lifeline: int | None = None
    # Its zenoh session with a peer that is silent for longer ends [s]
    session_timeout: float = SESSION_TIMEOUT
    # How often it tells what its containers count [s]; 0: never
    sample_every: float = SAMPLE_EVERY
    # The folder of its keys; empty: whoever reaches its port may command it
    keys: str = ""
    encrypts: bool = True  # whether its containers speak TLS with other computers
    # Folders of the code that it runs, or `DEPLOYED`: what is sent to it; empty: any
    allow: tuple[str, ...] = ()
    code: str = ""  # The folder of code that is sent to it; empty: it takes none
    account: Account | None = None  # What its containers run as; None: as it does
    is_witness: bool = False  # It votes for managers, and runs nothing


class AgentState(Versioned, frozen=True, kw_only=True):
    """What an agent must know of the one before it."""

    gateway: str = ""  # Its IP address and TCP port
    claim: Claim | None = None  # Of the manager that it obeys
    token: int = 0
    wanted: Deployment | None = None
    boot: str = ""  # When the computer has started since, nothing of it holds


Reply = Callable[[Answer], object]
"""Answers a request; called once, now or later, on any thread."""


class ContainerControl(Protocol):
    """The process of one container, and the agent's connection to it."""

    def note_born(self, pid: int) -> None:
        """Take note of its process; OSError or RuntimeError: no memory is free."""

    def send(self, record: ToContainer) -> None:
        """Send it a record, the rest of it when there is room; never waits."""

    def signal(self, number: Signals) -> None:
        """Send its process a signal; harmless when that has ended."""

    def extend_lease(self, until: float) -> None:
        """Let its leased components act until then [s, boot time]; any thread."""

    def is_lease_past(self) -> bool:
        """Return whether its leased components may not act any more, or not yet."""

    def heartbeat(self) -> int | None:
        """Return how often its control thread has run; None before it is born."""

    def close(self) -> None:
        """Let go of what leads to it."""


class ContainerHost(Protocol):
    """Where container processes are started, and what each gets of the computer."""

    @property
    def cpu_weights(self) -> str:
        """What gives containers their CPU weights, as in `AgentStatus`."""

    def start(self, spec: ContainerSpec) -> ContainerControl:
        """Begin to start a container; its birth and end are reported to the core."""

    def settle(self, spec: ContainerSpec, pid: int) -> None:
        """Give a process what its container is to have of the CPU and the memory."""

    def release(self, container: str) -> None:
        """Free what a container had that ended."""

    def count_kills(self, now: float) -> None:
        """Take note of processes that the kernel killed until `now` [s]."""

    def explain_kill(self, now: float) -> str:
        """Return why the kernel killed a process lately; each kill explains one end."""


class LeftContainers(Protocol):
    """Containers that an earlier agent has left: some may run and not have asked."""

    adopted: list[str]

    def awaits(self, container: str) -> bool:
        """Return whether a container may run still, and so must not be started."""

    def is_settled(self) -> bool:
        """Return whether all that were left have asked, or have ended."""

    def watch(self, pid: int) -> bool:
        """Tell the core when a process ends that nobody else watches."""

    def moment(self) -> float:
        """Return when `give_up` has something to do [s]."""

    def give_up(self) -> None:
        """Kill what did not ask in time; harmless when repeated."""

    def close(self) -> None:
        """Kill what was not adopted, and adopt no more."""


class AgentDisk(Protocol):
    """The folder of an agent. No method waits for the disk."""

    def keep(self, state: AgentState) -> None:
        """Keep what the next agent must know, if it changed; the last one counts."""

    def forget(self) -> None:
        """Leave nothing to the next agent: nothing runs any more."""

    def serve(self, request: ReadOutput | CheckpointCopy, reply: Reply) -> None:
        """Read or write what a manager asks for; answers when that is done."""

    def keep_only(self, wanted: Deployment) -> None:
        """Remove the checkpoints of all that is not wanted, and send the others."""

    def remove_checkpoints(self, of: Collection[tuple[str, int]]) -> None:
        """Remove the checkpoints of these names and epochs."""

    def resend(self) -> None:
        """Send all checkpoints again: there is another manager."""

    def checkpoint_age(self, component: str, epoch: int) -> float | None:
        """Return how old the last checkpoint is [s]; None: there is none."""

    def trouble(self) -> str:
        """Return what is wrong with it, in words; empty: nothing is."""


class CodeStore(Protocol):
    """The versions of the robot's code on this computer. No method waits for them."""

    def versions(self) -> tuple[str, ...]:
        """Return what is there, the last one first."""

    def keep(self, in_use: Collection[str]) -> None:
        """Remove no version that is to run from now on."""

    def serve(self, request: CodePart | InstallCode, reply: Reply) -> None:
        """Store or unpack; answers when that is done."""


class StandbyControl(Protocol):
    """The process on this computer that leads when nobody else does."""

    def keep(self, claim: Claim | None) -> None:
        """Let one wait that would lead as this claim says; None: none waits."""

    def lead(self) -> None:
        """Let it become the leader, if it can; harmless while it does."""


class HeartbeatTransport(Protocol):
    """Sends and takes heartbeats, from `start` on."""

    def start(self) -> None:
        """Begin."""

    def send_to(self, targets: Mapping[str, Address]) -> None:
        """Send to these from now on; by name."""

    def close(self) -> None:
        """End."""


class Surroundings(Struct, frozen=True, kw_only=True):
    """All that an agent's logic is given of the world."""

    clock: Clock
    # Returns the time [s since 1970]; for records that people read
    wall: Callable[[], float]
    # Returns for how long the computer has been suspended in all [s]: `clock` stands
    # still meanwhile
    asleep: Callable[[], float]
    random: Random  # Spreads restarts over time
    say: Callable[[str], object]  # Called with a sentence when a manager comes or goes
    publish: Callable[[AgentStatus], object]  # Sends a status to all managers
    # Lets managers see the agent, just before the first status
    appear: Callable[[], object]
    # Lets `AgentCore.tick` be called soon; from any thread, never blocks
    wake: Callable[[], None]
    host: ContainerHost
    adoption: LeftContainers
    disk: AgentDisk
    code: CodeStore | None = None  # None: it takes none
    standby: StandbyControl
    # Opens the transport of heartbeats; None: there is none
    heartbeats: Callable[[Hear, NextBeat], HeartbeatTransport | None]
    # What the agent and the containers use, and the agent's CPU time so far [s]
    usage: Callable[[], Usage]
    cpu: Callable[[], float]
    version: str = ""  # As in `AgentStatus`
    platform: str = ""
    cores: float = 0.0
    computer_memory: int = 0
    gateway: str  # Its address
    trouble: Callable[[], str]  # Why gateway or zygote do not work; empty: they do
    notice: Callable[[], str] = str  # What is to be known though nothing is wrong
    # The agent's process, and a text that no other start of an agent has
    pid: int
    key: str
