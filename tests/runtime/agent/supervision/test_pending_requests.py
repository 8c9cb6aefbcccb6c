"""What a container was asked is answered when its time is over."""

from __future__ import annotations

from unittest.mock import Mock

from poise.runtime.supervision.container_processes import (
    ContainerProcess,
    PendingRequests,
)
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.migration_records import MigrationSteps, Step

RESTORE = (Step("restore state", "eye", 1), Step("activate", "eye", 1))


def test_it_is_given_up_at_the_moment_at_which_it_is_due() -> None:
    """A tick that comes at just that moment would else be due again at once."""
    spec = ContainerSpec(name="one", folder="", components=(), connectors=())
    pending, reply = PendingRequests({"one": ContainerProcess(spec, Mock())}), Mock()
    asked = MigrationSteps(
        number=1, migration=1, container="one", steps=RESTORE, limit=2.0
    )
    pending.pass_on(asked, reply, now=10.0)
    pending.give_up(11.9)
    assert pending.moment() == 12.0
    reply.assert_not_called()
    pending.give_up(pending.moment())
    assert pending.moment() == float("inf")
    (answer,) = reply.call_args.args
    assert (
        answer.reason == "container 'one' took over 2 s for 'restore state', 'activate'"
    )
