"""Responders are asked in order, and one that raises stops none of the others."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.manage.adaptation import placement_responders
from poise.manage.adaptation.decision import Decision
from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.placement_responders import Transitions
from poise.manage.adaptation.policies import Policies
from poise.manage.adaptation.situation import Change, Responder, Situation
from poise.manage.adaptation.when_to_act import JUDGE_AFTER, SETTLE
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.migration.migration_report import TransitionReport, TransitionStep
from poise.model.policy import Policy
from poise.testing import VirtualClock
from tests.manage.adaptation.shortages.test_suspension import Robbed, robot_with

PURPOSES = [
    "restart components of lost computers",
    "stop a task that lacks a needed function",
    "carry out policies",
    "start suspended architectures again",
    "plan again",
    "use computers that are back",
]


class Asked:
    """Notes that it was asked, and what a test says then."""

    def __init__(self, replaces: Responder) -> None:
        self.purpose = replaces.purpose
        self.times = 0
        self.error: Exception | None = None
        self.change: Change | None = None

    def respond(self, situation: Situation, desired: Desired) -> Change | None:
        del situation, desired
        self.times += 1
        if self.error is not None:
            raise self.error
        return self.change


class Rig:
    """A loop with such responders."""

    def __init__(self) -> None:
        self.robbed, self.clock = Robbed(robot_with()), VirtualClock()
        self.parts = self.robbed.run.parts
        self.parts._clock = self.clock
        self.loop = Adaptation(
            self.robbed.run,
            self.robbed.situation,
            self.robbed.suspensions,
            is_well=lambda: self.is_well,
            clock=self.clock.now,
        )
        self.is_well = False
        self.asked = [Asked(each) for each in self.loop.responders]
        self.loop.responders = tuple(self.asked)


def test_the_table_says_who_is_asked_in_which_order() -> None:
    robbed = Robbed(robot_with())
    loop = Adaptation(robbed.run, robbed.situation, robbed.suspensions)
    assert [each.purpose for each in loop.responders] == PURPOSES


@pytest.mark.parametrize("number", range(len(PURPOSES)))
def test_one_that_raises_is_said_and_the_others_are_asked(number: int) -> None:
    rig = Rig()
    rig.asked[number].error = KeyError("odd")
    for _ in range(2):
        rig.loop.adapt()
    times = [each.times for each in rig.asked]
    assert times == [1 if each == number else 2 for each in range(len(PURPOSES))]
    (deviation,) = rig.parts.deviations()
    assert f"the manager cannot {PURPOSES[number]} (KeyError" in deviation.what
    rig.asked[number].error = None
    rig.clock.sleep(2.0)
    rig.loop.adapt()
    assert rig.parts.deviations() == []


def test_the_first_that_wants_a_change_is_the_last_that_is_asked() -> None:
    rig, done = Rig(), list[str]()
    rig.asked[2].change = Change(why="so", carry_out=lambda: done.append("it"))
    rig.loop.adapt()
    assert done == ["it"]
    assert [each.times for each in rig.asked] == [1, 1, 1, 0, 0, 0]
    assert rig.robbed.journal.entries()[-1].what == "so"


def test_while_all_is_well_it_looks_less_often() -> None:
    rig = Rig()
    asked = rig.asked[0]
    for is_well, times in (True, 4), (False, 10):
        asked.times, rig.is_well = 0, is_well
        for _ in range(10):
            rig.loop.adapt()
            rig.clock.sleep(0.2)
        assert asked.times == times


def test_what_begins_or_is_changed_is_looked_at_again_at_once() -> None:
    rig = Rig()
    asked, rig.is_well = rig.asked[0], True
    asked.change = Change(carry_out=lambda: None)
    rig.loop.adapt()
    rig.loop.adapt()
    assert asked.times == 2
    asked.change = None
    rig.loop._read = lambda: rig.robbed.situation(0.0, "a")
    for _ in range(3):
        rig.loop.adapt()
    assert asked.times == 5


def test_what_comes_and_goes_is_said_once() -> None:
    """At its limit, "overloaded" and "no more" took turns every second."""
    rig = Rig()
    robbed, seen = rig.robbed, list[Situation]()
    rig.loop._read = lambda: seen[-1]
    for second in range(40):
        is_late = second % 4 < 2 and second < 20
        seen.append(robbed.situation(0.0, *(["a"] if is_late else [])))
        rig.loop.adapt()
        rig.clock.sleep(1.0)
    said = [e.what for e in robbed.journal.entries() if e.kind in {"wrong", "right"}]
    (wrong, right) = [what for what in said if "timer" in what]
    assert right == f"no more: {wrong}"
    assert rig.loop.deviations == ()


def test_a_status_has_the_present_figures_of_what_is_wrong() -> None:
    """It said for ever "missed 3 of 8", as of the first look."""
    rig = Rig()
    seen, read = rig.robbed.situation(0.0, "a"), list[Situation]()
    rig.loop._read = lambda: read[-1]
    for missed in 3, 9:
        (late,) = (replace(timer, missed=missed) for timer in seen.misses)
        read.append(replace(seen, misses=(late,)))
        for _ in range(2):
            rig.loop.adapt()
            rig.clock.sleep(0.5)
    (deviation,) = rig.loop.deviations
    assert "missed 9 of" in deviation.what
    said = [e.what for e in rig.robbed.journal.entries() if e.kind == "wrong"]
    assert ["missed 3 of" in what for what in said if "timer" in what] == [True]


def test_what_a_move_has_mended_is_over_at_once() -> None:
    """A status said for 5 s more that it is late where it was before."""
    rig = Rig()
    statuses = rig.robbed.run.current()
    late = replace(rig.robbed.situation(0.0, "high"), statuses=statuses)
    well = replace(late, misses=(), placement={**late.placement, "high": "right"})
    read = list[Situation]()
    rig.loop._read = lambda: read[-1]
    for situation, is_wrong in (late, True), (well, False):
        read.append(situation)
        for _ in range(3):
            rig.loop.adapt()
            rig.clock.sleep(0.3)
        assert bool(rig.loop.deviations) == is_wrong
    said = [e.what for e in rig.robbed.journal.entries() if e.kind == "right"]
    assert any("'high' on 'left' missed" in what for what in said)


def test_a_change_that_fails_backs_off_and_lets_the_next_act() -> None:
    def fail() -> None:
        raise KeyError("odd")

    rig = Rig()
    rig.asked[0].change = Change(carry_out=fail)
    rig.loop.adapt()
    rig.loop.adapt()
    assert [each.times for each in rig.asked] == [1, 2, 2, 2, 2, 2]


def test_it_rests_after_a_transition_however_long_that_took(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A cold move may take longer than loads take to settle; so may its judgement."""
    robbed, clock = Robbed(robot_with()), VirtualClock()

    def transit(_: LiveRobot, steps: tuple[TransitionStep, ...]) -> TransitionReport:
        clock.sleep(5.0)
        return TransitionReport(steps=steps, committed=True)

    monkeypatch.setattr(placement_responders, "transit", transit)
    transitions = Transitions(robbed.run, Policies([]), robbed.suspensions, clock.now)
    decision = Decision(acts=True, why="it helps", gain=1.0, undone=1.0)
    change = transitions.change(decision, (), robbed.situation())
    change.carry_out()
    assert transitions.limits.is_backing_off(clock.now() + 0.9 * SETTLE)
    assert not transitions.limits.is_backing_off(clock.now() + SETTLE)
    transitions.loss.judge(1.0, clock.now() + 0.9 * JUDGE_AFTER)
    assert transitions.loss.doubt == 1.0
    transitions.loss.judge(1.0, clock.now() + JUDGE_AFTER)
    assert transitions.loss.doubt == 2.0


def test_a_fail_over_of_a_computer_that_is_up_is_reported_alone() -> None:
    """Its components were started elsewhere beside themselves, again and again."""
    robot = robot_with()
    (left,) = robot.computers
    mine = Policy(
        name="mine",
        for_each="computer",
        when="components > 0",
        lasts=0.0,
        do="fail over",
        say="'{name}' is odd",
    )
    computers = left, replace(left, name="right")
    robot = replace(robot, computers=computers, policies=(mine,))
    robbed = Robbed(robot, {"high": "left", "low": "left"})
    loop = Adaptation(robbed.run, robbed.situation, robbed.suspensions)
    loop.adapt()
    assert [each.what for each in loop.deviations] == ["'left' is odd"]
    assert not [e for e in robbed.journal.entries() if "a lost computer" in e.what]
