"""What a manager asks of agents, with the answers."""

from __future__ import annotations

import time
from collections.abc import Mapping

from msgspec import Struct

from poise.wire.records.checkpoint_records import CheckpointCopy
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsFailed
from poise.wire.records.output_records import OutputLines, ReadOutput
from poise.wire.records.tap_records import Tap, TapReading

PROTOCOL = 10
"""Manager, agents and containers of different protocol versions refuse each other."""


class ManagerId(Struct, frozen=True, kw_only=True):
    """One start of a manager."""

    key: str  # Unique; its liveliness token is ``poise/ROBOT/manager/KEY``
    # Where it runs, for people
    user: str
    host: str
    pid: int
    since: float  # When it started [s since 1970]
    # Higher than that of every manager which an agent obeyed when this one began to
    # claim them; 0 before. Of two managers the one with the lower `rank` gives way
    term: int = 0

    @property
    def rank(self) -> tuple[int, float, str]:
        """Which of two managers is the later one: clocks of computers may differ."""
        return self.term, self.since, self.key

    def __str__(self) -> str:
        """Return who it is, for people."""
        began = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        return f"user {self.user} on {self.host} (process {self.pid}) since {began}"


class Claim(Struct, frozen=True, tag=True):
    """Obey this manager from now on."""

    manager: ManagerId
    take_over: bool = False  # Even if another one is obeyed
    # Computer -> zenoh endpoint, of all agents of the robot: they exchange heartbeats
    agents: Mapping[str, str] = {}
    # Whether the manager exchanges heartbeats with them, too; else nothing is leased
    is_leased: bool = False


class Claimed(Struct, frozen=True, tag=True):
    """An agent's answer to a claim: it obeys the manager from now on."""

    # What it works towards, as an earlier manager told it; None: nothing yet
    deployment: Deployment | None = None
    # Whether its lease had ended: what may move is inactive there, and may have been
    # started elsewhere
    is_cut_off: bool = False


class Accepted(Struct, frozen=True, tag=True):
    """An agent's answer: it works towards the deployment."""


class Refused(Struct, frozen=True, tag=True):
    """An agent's answer: it changed nothing, and why."""

    reason: str


Answer = (
    Accepted | Claimed | Refused | StepsDone | StepsFailed | TapReading | OutputLines
)

Request = Claim | Deployment | MigrationSteps | CheckpointCopy | Tap | ReadOutput
"""What a manager asks of an agent."""


class ManagerRequest(Struct, frozen=True, kw_only=True):
    """A request with its manager's fencing token: agents refuse any other."""

    protocol: int = PROTOCOL
    token: int
    request: Request
