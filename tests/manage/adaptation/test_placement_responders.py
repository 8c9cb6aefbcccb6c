"""When a better placement is taken, and how often what was lost is tried elsewhere."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from msgspec.structs import replace

from poise.manage.adaptation import placement_responders
from poise.manage.adaptation.decision import HORIZON, Decision
from poise.manage.adaptation.placement_responders import (
    FailoverPlan,
    FailoverResponder,
    ReplanResponder,
    Transitions,
)
from poise.manage.adaptation.policies import Policies, Symptom
from poise.manage.adaptation.situation import Change
from poise.manage.adaptation.when_to_act import FIRST_BACKOFF, JUDGE_AFTER, STAY_AWAY
from poise.manage.migration.migration_report import (
    MigrationReport,
    Proposal,
    TransitionReport,
    TransitionStep,
)
from poise.model.policy import COOL_DOWN, ComputerValues, LinkValues, Policy
from tests.manage.adaptation.shortages.test_suspension import Robbed, robot_with

FULL = Symptom(
    policy=Policy(name="full", for_each="computer", when="full", do="replan", say=""),
    what="'left' is full",
    values=ComputerValues(name="left"),
)
CUT = Symptom(
    policy=Policy(name="cut", for_each="link", when="cut", do="replan", say=""),
    what="left-right is cut",
    values=LinkValues(name="left-right"),
)
HELPS = Decision(acts=True, why="it helps", gain=0.1, cost=1.0, undone=0.1)
IN_VAIN = Decision(acts=False, why="no placement can help")


class Replanning:
    """A loop that thinks what a test says, about what was seen first at 0 s."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.robbed = Robbed(robot_with())
        self.policies = Policies([])
        self.policies.since = {FULL.key: 0.0, CUT.key: 0.0}
        self.transitions = Transitions(
            self.robbed.run, self.policies, self.robbed.suspensions, lambda: 0.0
        )
        self.responder = ReplanResponder(self.transitions)
        self.decision = HELPS
        self.asked: list[dict[str, Any]] = []
        monkeypatch.setattr(placement_responders, "decide", self.decide)

    def decide(self, situation: object, **how: float) -> Decision:
        self.asked.append({"situation": situation, **how})
        return self.decision

    def look(self, now: float, *symptoms: Symptom) -> Change | None:
        seen = replace(self.robbed.situation(), symptoms=symptoms, now=now)
        return self.responder.respond(seen, self.robbed.run.desired)

    def said(self) -> list[str]:
        return [e.what for e in self.robbed.journal.entries() if e.kind == "seen"]


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Replanning:
    return Replanning(monkeypatch)


def test_a_change_is_made_once_what_was_lost_without_it_equals_its_cost(
    rig: Replanning,
) -> None:
    """0.1 cores are lost for 10 s; it is thought about twice a second at most."""
    assert rig.look(1.0, FULL) is None
    assert rig.look(1.4, FULL) is None
    assert len(rig.asked) == 1
    assert rig.look(1.5, FULL) is None
    assert len(rig.asked) == 2
    assert rig.look(9.9, FULL) is None
    assert rig.look(9.95, FULL) is None
    assert len(rig.asked) == 3
    change = rig.look(10.01, FULL)
    assert change is not None
    assert change.why == "it helps"


def test_what_has_been_wrong_for_long_is_expected_to_last_as_long(
    rig: Replanning,
) -> None:
    rig.look(1.0, FULL)
    rig.look(HORIZON + 20.0, FULL)
    assert [each["horizon"] for each in rig.asked] == [HORIZON, HORIZON + 20.0]


def test_what_nothing_helps_is_said_once_and_thought_about_less_and_less(
    rig: Replanning,
) -> None:
    rig.decision = IN_VAIN
    rig.look(0.0, FULL)
    rig.look(FIRST_BACKOFF - 0.1, FULL)
    assert len(rig.asked) == 1
    rig.look(FIRST_BACKOFF, FULL)
    rig.look(3 * FIRST_BACKOFF - 0.1, FULL)
    assert len(rig.asked) == 2
    assert rig.said() == ["no placement can help"]
    rig.look(3 * FIRST_BACKOFF, FULL, CUT)
    assert rig.said() == 2 * ["no placement can help"]  # there is another symptom


def test_what_goes_wrong_next_is_thought_about_at_once(rig: Replanning) -> None:
    rig.decision = IN_VAIN
    rig.look(0.0, FULL)
    rig.look(0.5)
    rig.look(1.0, FULL)
    assert len(rig.asked) == 2
    assert rig.said() == 2 * ["no placement can help"]


def test_only_bad_links_are_taken_for_bad_links(rig: Replanning) -> None:
    rig.look(1.0, FULL, CUT)
    assert rig.asked[0]["situation"].bad_links == {"left-right"}


def test_what_was_urgent_is_so_until_it_was_in_time_for_long(rig: Replanning) -> None:
    """Else it brings back what crowded it, as soon as another one is late."""
    crowded = rig.robbed.situation(0.2, "high")
    late = tuple(replace(m, takes=0.12, deadline=0.1) for m in crowded.misses)
    for now, misses in (1.0, late), (2.0, ()), (1.0 + STAY_AWAY, ()):
        seen = replace(crowded, symptoms=(FULL,), now=now, misses=misses)
        rig.responder.respond(seen, rig.robbed.run.desired)
    found = [each["situation"].urgency for each in rig.asked]
    assert found == [{"high": pytest.approx(1.2)}] * 2 + [{}]


def test_what_is_lost_while_all_is_well_or_nothing_helps_does_not_count(
    rig: Replanning,
) -> None:
    rig.decision = replace(IN_VAIN, gain=1.0)
    rig.look(0.0, FULL)
    rig.decision = HELPS
    assert rig.look(FIRST_BACKOFF, FULL) is None
    assert rig.look(FIRST_BACKOFF + 0.5) is None
    rig.policies.since = {FULL.key: 100.0}
    assert rig.look(100.0, FULL) is None
    assert rig.look(109.0, FULL) is None
    assert rig.look(110.0, FULL) is not None


def test_after_a_change_in_vain_costs_count_twice(rig: Replanning) -> None:
    rig.transitions.loss.note_change(HELPS.undone, HELPS.gain, 0.0)
    rig.look(JUDGE_AFTER, FULL)
    rig.look(2 * JUDGE_AFTER, FULL)
    assert [each["doubt"] for each in rig.asked] == [1.0, 2.0]


@pytest.mark.parametrize("committed", [True, False])
def test_what_a_change_suspends_is_remembered_once_it_is_done(
    rig: Replanning, monkeypatch: pytest.MonkeyPatch, *, committed: bool
) -> None:
    move = MigrationReport(
        what="low",
        before={"low": "left"},
        after={"low": "left"},
        downtime=0.2,
        committed=committed,
    )
    report = TransitionReport(steps=(), moves=(move,), committed=committed)
    monkeypatch.setattr(placement_responders, "transit", lambda *_: report)
    proposal = cast("Proposal", SimpleNamespace(steps=(), suspended=("low-task",)))
    rig.decision = replace(HELPS, proposal=proposal)
    change = rig.look(50.0, FULL)
    assert change is not None
    change.carry_out()
    assert len(rig.robbed.sentences()) == committed
    assert rig.transitions.downtimes == {"low": 0.2}


def test_what_was_acted_on_cools_down(rig: Replanning) -> None:
    rig.policies.note_acted((FULL,), 10.0)
    assert rig.look(10.0 + COOL_DOWN - 0.1, FULL) is None
    assert not rig.asked
    change = rig.look(10.0 + COOL_DOWN, FULL)
    assert change is not None
    change.carry_out()
    assert not rig.policies.due((FULL,), 10.0 + COOL_DOWN + 0.1)


LOST = Symptom(
    policy=Policy(name="l", for_each="computer", when="lost", do="fail over", say=""),
    what="'left' is lost",
    values=ComputerValues(name="left"),
)
STEPS = (TransitionStep("high", "left", "left"),)


class FailingOver:
    """What was on `left`, and goes where a test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, plan: FailoverPlan) -> None:
        self.robbed = Robbed(robot_with())
        self.responder = FailoverResponder(self.robbed.run, self.robbed.suspensions)
        self.plan, self.planned = plan, 0
        self.starts, self.moves, self.suspends = True, True, True
        self.did: list[str] = []
        patch = monkeypatch.setattr
        patch(placement_responders, "plan_failover", self.plan_failover)
        patch(placement_responders, "start_together", self.start)
        patch(placement_responders, "transit", self.transit)
        patch(self.robbed.suspensions, "suspend", self.suspend)

    def plan_failover(self, *_: object) -> FailoverPlan:
        self.planned += 1
        return self.plan

    def start(self, _: object, placement: object, lost: object) -> bool:
        assert (placement, lost) == (self.plan.placement, {"left"})
        self.did.append("start")
        return self.starts

    def transit(self, *_: object) -> TransitionReport:
        self.did.append("move")
        return TransitionReport(steps=STEPS, committed=self.moves)

    def suspend(self, *_: object) -> bool:
        self.did.append("suspend")
        return self.suspends

    def look(self, now: float, *, is_lost: bool = True) -> bool:
        seen = replace(self.robbed.situation(), now=now)
        if is_lost:
            seen = replace(seen, symptoms=(LOST,), lost=frozenset({"left"}))
        return self.robbed.respond(self.responder, seen, now)

    def said(self) -> list[str]:
        return [e.what for e in self.robbed.journal.entries() if e.kind == "wrong"]


ALL = FailoverPlan(
    placement={"low": "right"}, missing={}, suspended=("other",), steps=STEPS
)


def test_room_is_made_before_what_was_lost_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = FailingOver(monkeypatch, ALL)
    assert rig.look(0.0)
    assert rig.did == ["suspend", "move", "start"]
    assert rig.look(0.1)  # it went well: there is nothing to wait for


@pytest.mark.parametrize(
    ("what", "did"),
    [
        ("suspends", ["suspend"]),
        ("moves", ["suspend", "move"]),
        ("starts", ["suspend", "move", "start"]),
    ],
)
def test_where_a_step_fails_none_follows_and_all_is_tried_again_later(
    monkeypatch: pytest.MonkeyPatch, what: str, did: list[str]
) -> None:
    rig = FailingOver(monkeypatch, ALL)
    setattr(rig, what, False)
    assert rig.look(0.0)
    assert rig.did == did
    assert not rig.look(FIRST_BACKOFF - 0.1)
    assert rig.planned == 1
    assert rig.look(FIRST_BACKOFF)
    assert rig.did == 2 * did


def test_what_is_missing_is_said_once_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing = {"high": "it is full", "low": "it is full"}
    plan = FailoverPlan(placement={}, missing=missing)
    rig = FailingOver(monkeypatch, plan)
    for now in (0.0, 4.9):
        assert not rig.look(now)
        assert rig.planned == 1
    assert not rig.look(5.0)
    assert rig.planned == 2
    assert len(rig.said()) == 2
    assert rig.said()[0] == "component 'high' of 'left' is missing: it is full"


def test_what_was_missing_is_looked_at_anew_when_it_is_lost_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    missing = {"high": "it is pinned", "low": "it is pinned"}
    rig = FailingOver(monkeypatch, FailoverPlan(placement={}, missing=missing))
    rig.look(0.0)
    rig.look(1.0, is_lost=False)
    rig.look(2.0)
    assert rig.planned == 2
    assert len(rig.said()) == 4


def test_after_a_success_the_first_failure_is_tried_again_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = FailingOver(monkeypatch, ALL)
    rig.starts = False
    rig.look(0.0)
    rig.starts = True
    assert rig.look(10.0)
    rig.starts = False
    assert rig.look(20.0)
    assert rig.look(20.0 + FIRST_BACKOFF)
