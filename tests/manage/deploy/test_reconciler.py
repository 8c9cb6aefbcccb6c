"""The reconciler brings agents to what should run, step by step, and never raises."""

from __future__ import annotations

import itertools
from typing import cast

import pytest
from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.reports import LOOK_EVERY
from poise.manage.agent_connections.requests import ANSWER_LIMIT, PendingAnswer
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.reconciler import (
    APPLY_LIMIT,
    TRY_AGAIN,
    WITNESS_LIMIT,
    JoiningComputer,
)
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.testing import VirtualClock
from poise.wire.records.deployment_records import Deployment, Goal
from poise.wire.records.migration_records import MigrationSteps, StepsDone, StepsFailed
from poise.wire.records.request_records import CheckpointCopy, Claimed
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}


class Silent(FakeAgents):
    """Agents of which some give no answer until a test says so."""

    def __init__(self) -> None:
        super().__init__("left", "right")
        self.mute: set[str] = set()
        self.stubborn: set[str] = set()
        self.ended_claims: list[str] = []
        self.asked = 0

    def begin_claim(self, computer: str) -> PendingAnswer:
        if computer in self.mute:
            self.claimed.append(computer)
            return PendingAnswer()
        reply = super().begin_claim(computer)
        self.strangers |= self.stubborn & {computer}
        return reply

    def end_claim(self, computer: str, reply: PendingAnswer) -> None:
        assert isinstance(reply.answer, Claimed)
        self.ended_claims.append(computer)

    def begin_steps(self, computer: str, steps: MigrationSteps) -> PendingAnswer:
        self.asked += 1
        silent = computer in self.mute
        return PendingAnswer() if silent else super().begin_steps(computer, steps)

    def begin_keeping(self, computer: str, copy: CheckpointCopy) -> PendingAnswer:
        if computer in self.mute:
            return PendingAnswer()
        return super().begin_keeping(computer, copy)

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        if computer in self.mute:
            self.deployed.append((computer, deployment))
            return PendingAnswer()
        return super().begin_deploy(computer, deployment)


class Rig:
    """A robot that runs, on a clock that a test sets."""

    def __init__(self, robot: Robot) -> None:
        self.clock, self.agents = VirtualClock(), Silent()
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(
            robot, PLACEMENT, agents, self.journal, "/run", clock=self.clock
        )
        self.run.start()
        self.run.goes_on_without_lost = True
        self.agents.deployed.clear()
        self.agents.claimed.clear()

    def told(self) -> list[str]:
        """Return which agents were told something since the last time."""
        told = [computer for computer, _ in self.agents.deployed]
        self.agents.deployed.clear()
        return told

    def rest(self, name: str) -> None:
        """Let a component be inactive from now on."""
        self.run.commit(self.run.desired.aiming("inactive", [name]), "a test")

    def later(self, seconds: float) -> list[str]:
        """Return which agents are told something after a time."""
        self.clock.sleep(seconds)
        self.run.reconcile()
        return self.told()


@pytest.fixture
def rig(robot: Robot) -> Rig:
    return Rig(robot)


def test_agents_are_told_only_what_has_changed_for_them(rig: Rig) -> None:
    rig.rest("thinker")
    assert rig.told() == ["right"]
    assert rig.later(10.0) == []


def test_an_agent_that_refuses_is_told_again_later_and_that_is_said(rig: Rig) -> None:
    rig.agents.refusing.add("right")
    rig.rest("thinker")
    why = "the agent of 'right' refused: not today"
    assert rig.run.reconciler.troubles() == {"right": why}
    with pytest.raises(RunError, match="not today"):
        rig.run.wait([rig.run.placed["thinker"]], 0.0)
    rig.agents.refusing.clear()
    assert rig.later(TRY_AGAIN / 2) == []
    assert rig.later(TRY_AGAIN) == ["right"]
    assert rig.run.reconciler.troubles() == {}


def test_an_agent_that_is_late_holds_up_no_other(rig: Rig) -> None:
    rig.agents.mute.add("right")
    rig.rest("thinker")
    rig.rest("grabber")
    rig.run.wait([rig.run.placed["grabber"]], 0.0)
    assert rig.run.reconciler.troubles() == {}
    rig.told()
    assert rig.later(ANSWER_LIMIT) == []
    why = f"the agent of 'right' did not answer within {ANSWER_LIMIT:g} s"
    assert rig.run.reconciler.troubles() == {"right": why}
    rig.agents.mute.clear()
    assert rig.later(TRY_AGAIN) == ["right"]


def test_what_an_agent_accepted_and_does_not_work_towards_is_told_again(
    rig: Rig,
) -> None:
    rig.agents.deaf.add("right")
    rig.rest("thinker")
    assert rig.told() == ["right"]
    assert rig.later(APPLY_LIMIT / 2) == []
    assert rig.later(APPLY_LIMIT) == ["right"]


def test_what_is_newer_overtakes_what_waits_for_an_answer(rig: Rig) -> None:
    rig.agents.mute.add("right")
    rig.rest("thinker")
    rig.agents.mute.clear()
    rig.run.commit(rig.run.desired.aiming("active", ["thinker"]), "again")
    assert rig.told() == ["right", "right"]
    rig.run.wait([rig.run.placed["thinker"]], 0.0)


def test_an_agent_that_obeys_another_is_claimed_first(rig: Rig) -> None:
    rig.agents.strangers.add("right")
    rig.rest("thinker")
    assert (rig.agents.claimed, rig.told()) == (["right"], [])
    assert rig.later(0.0) == ["right"]


def test_nothing_is_told_before_what_was_found_is_known(rig: Rig) -> None:
    """An agent may report that it obeys before its answer to the claim is looked at."""
    rig.run.claimed.discard("right")
    there = structs.replace(rig.run.placed["thinker"], epoch=7)
    plan = rig.run.layout.deployments(Desired(coming=(there,), generation=9), {})[
        "right"
    ]
    rig.agents.left_with["right"] = plan
    rig.agents.strangers.add("right")
    rig.run.reconcile()  # it obeys from now on
    rig.run.reconcile()
    told = [d for computer, d in rig.agents.deployed if computer == "right"]
    epochs = {c.epoch for d in told for k in d.containers for c in k.components}
    assert epochs == {7}


def test_one_that_refuses_a_claim_is_asked_again_later(rig: Rig) -> None:
    rig.agents.strangers.add("right")
    rig.agents.refusing.add("right")
    for _ in range(3):
        assert rig.later(0.1) == []
    assert rig.agents.claimed == ["right"]
    assert "right" in rig.run.reconciler.troubles()
    assert rig.later(TRY_AGAIN) == []
    assert rig.agents.claimed == ["right", "right"]


def test_a_claim_is_not_repeated_while_it_may_be_answered_or_seen(rig: Rig) -> None:
    rig.agents.strangers.add("right")
    rig.agents.mute.add("right")
    for _ in range(3):
        rig.later(ANSWER_LIMIT / 4)
    assert rig.agents.claimed == ["right"]
    rig.agents.mute.clear()
    rig.agents.stubborn.add("right")  # it obeys, and reports that late
    rig.later(ANSWER_LIMIT)
    rig.later(TRY_AGAIN)
    assert rig.agents.claimed == ["right", "right"]
    rig.later(0.0)
    assert rig.agents.ended_claims == ["right"]
    rig.later(APPLY_LIMIT - 0.1)
    assert rig.agents.claimed == ["right", "right"]
    rig.later(0.1)
    assert rig.agents.claimed == ["right", "right", "right"]


def test_a_manager_that_was_replaced_claims_nothing_back(rig: Rig) -> None:
    rig.agents.later = structs.replace(rig.agents.manager, key="later")
    rig.agents.strangers.add("right")
    rig.rest("thinker")
    assert (rig.agents.claimed, rig.told()) == ([], [])


def test_what_was_away_is_told_again_and_no_trouble_of_before_is_said(
    rig: Rig,
) -> None:
    rig.agents.refusing.add("right")
    rig.rest("thinker")
    assert rig.run.reconciler.troubles()
    rig.agents.gone.add("right")
    rig.told()
    assert rig.later(10.0) == []
    assert rig.run.reconciler.troubles() == {}
    assert rig.run.reconciler.refusal("right") == ""
    rig.agents.refusing.clear()
    rig.agents.gone.clear()
    assert rig.later(0.0) == ["right"]
    assert rig.later(10.0) == []
    rig.agents.gone.add("right")
    rig.later(0.1)
    rig.agents.gone.clear()
    assert rig.later(0.0) == ["right"]  # it may have been started again meanwhile


def test_an_agent_that_has_not_reported_since_it_is_back_is_waited_for(
    rig: Rig,
) -> None:
    rig.agents.forget("right")
    rig.rest("thinker")
    assert (rig.agents.claimed, rig.told()) == ([], [])


def test_a_restarted_agent_is_told_though_nothing_has_changed(rig: Rig) -> None:
    status = rig.agents.statuses()["right"]
    rig.agents.report(structs.replace(status, pid=99))
    assert rig.later(0.0) == ["right"]


def test_each_commit_is_journalled_with_what_changes(rig: Rig) -> None:
    rig.rest("thinker")
    entry = rig.journal.entries()[-1]
    assert (entry.kind, entry.what) == ("desired", "a test")
    assert entry.facts["changes"] == ["thinker/0 on right (active) -> inactive"]


def joining(
    rig: Rig, *, goal: Goal = "inactive", held: bool = False, lacks: bool = False
) -> JoiningComputer:
    """Return the right computer, on which the thinker is found."""
    found = structs.replace(rig.run.placed["thinker"], goal=goal, held=held)
    deployment = rig.run.layout.deployments(Desired(coming=(found,), generation=9), {})[
        "right"
    ]
    copy = CheckpointCopy(component="thinker", epoch=0, data=b"x", age=1.0)
    return JoiningComputer(
        "right",
        deployment,
        cast("Agents", rig.agents),
        rig.clock,
        itertools.count(),
        is_cut_off=False,
        lacking=[copy] if lacks else [],
    )


def test_what_is_at_work_or_held_is_no_target_of_a_move(rig: Rig) -> None:
    assert joining(rig, goal="active").is_known()
    assert joining(rig, held=True).is_known()
    assert rig.agents.asked == 0


def test_what_does_not_say_whether_it_counts_does(rig: Rig) -> None:
    """It is asked again now and then; while it is out of reach nothing is known."""
    rig.agents.mute.add("right")
    right = joining(rig)
    rig.agents.gone.add("right")
    rig.clock.sleep(2 * WITNESS_LIMIT)
    assert not right.is_known()
    rig.agents.gone.clear()
    rig.clock.sleep(WITNESS_LIMIT - 0.1)
    assert not right.is_known()
    rig.clock.sleep(0.1)
    assert right.is_known()
    assert right.committed == {("thinker", 0)}


def test_one_that_cannot_say_yet_is_asked_again_now_and_then(rig: Rig) -> None:
    rig.agents.halted["right"] = StepsFailed(0, "it is busy")
    right = joining(rig)
    for _ in range(3):
        assert not right.is_known()
    assert rig.agents.asked == 1
    rig.clock.sleep(LOOK_EVERY)
    assert not right.is_known()
    assert rig.agents.asked == 2
    rig.agents.halted["right"] = StepsDone(0)
    rig.clock.sleep(LOOK_EVERY)
    assert not right.is_known()
    assert right.is_known()
    assert not right.committed


def test_nothing_starts_before_its_checkpoint_is_there_or_late(rig: Rig) -> None:
    rig.agents.mute.add("right")
    right = joining(rig, goal="active", lacks=True)
    assert not right.is_known()
    rig.clock.sleep(60.0)
    assert right.is_known()
    ((_, why),) = right.checkpoints()
    assert why
    rig.agents.mute.clear()
    right = joining(rig, goal="active", lacks=True)
    assert right.is_known()
    ((_, why),) = right.checkpoints()
    assert why == ""
