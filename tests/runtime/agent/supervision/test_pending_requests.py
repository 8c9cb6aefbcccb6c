"""What a container was asked is answered when its time is over."""

from __future__ import annotations

from unittest.mock import Mock

from poise.runtime.supervision.container_processes import (
    ContainerProcess,
    PendingRequests,
)
from poise.runtime.supervision.health import HealthRecords
from poise.wire.records.deployment_records import ContainerSpec
from poise.wire.records.migration_records import MigrationSteps, Step

RESTORE = (Step("restore state", "eye", 1), Step("activate", "eye", 1))
ASKED = MigrationSteps(number=1, migration=1, container="one", steps=RESTORE, limit=2.0)


def test_it_is_given_up_at_the_moment_at_which_it_is_due() -> None:
    """A tick that comes at just that moment would else be due again at once."""
    spec = ContainerSpec(name="one", folder="", components=(), connectors=())
    processes, reply = {"one": ContainerProcess(spec, Mock())}, Mock()
    pending = PendingRequests(processes, Mock())
    pending.pass_on(ASKED, reply, now=10.0)
    pending.give_up(11.9)
    assert pending.moment() == 12.0
    reply.assert_not_called()
    pending.give_up(pending.moment())
    assert pending.moment() == float("inf")
    (answer,) = reply.call_args.args
    assert (
        answer.reason == "container 'one' took over 2 s for 'restore state', 'activate'"
    )


def test_the_answer_for_a_container_that_ended_says_how() -> None:
    """Of a move whose state found no memory was said: "container 'one' ended"."""
    spec = ContainerSpec(name="one", folder="", components=(), connectors=())
    processes, reply = {"one": ContainerProcess(spec, Mock())}, Mock()
    health = HealthRecords(lambda: 0.0, lambda: 0.0)
    pending = PendingRequests(processes, health.how_ended)
    pending.pass_on(ASKED, reply, now=10.0)
    processes["one"].give_up()  # its socket ends before the kernel says why
    pending.give_up(10.1)
    reply.assert_not_called()
    del processes["one"]
    health.note_fault("one", "was killed by SIGKILL")
    pending.give_up(10.1)
    (answer,) = reply.call_args.args
    assert answer.reason == "container 'one' was killed by SIGKILL"
    assert health.how_ended("other") == "ended"
    health.enter("one", "stopped")  # that fault was another end
    assert health.how_ended("one") == "ended"
