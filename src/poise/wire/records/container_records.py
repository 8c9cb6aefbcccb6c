"""What an agent and its containers tell each other."""

from __future__ import annotations

from msgspec import Struct

from poise.wire.records.clock_records import Clocks
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsFailed
from poise.wire.records.status_records import ContainerStatus
from poise.wire.records.tap_records import Tap, TapReading


class ContainerFailure(Struct, frozen=True, tag=True):
    """The last words of a container that cannot go on."""

    reason: str


Order = MigrationSteps | Tap
"""What a container answers with an outcome."""
Outcome = StepsDone | StepsFailed | TapReading


ToContainer = ContainerSpec | Clocks | Order
"""What an agent tells a container."""
FromContainer = ContainerStatus | ContainerFailure | Outcome
"""What a container tells its agent."""
