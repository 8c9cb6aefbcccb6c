"""What a task does when a function that it needs, or only uses, is missing."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from msgspec.structs import replace

from poise.manage.adaptation.loop import Adaptation
from poise.manage.shortages.suspension import FIRST, NeededFunctions, missing_functions
from poise.model.robot import Action, Computer, Robot, Task
from tests.manage.adaptation.shortages.test_suspension import (
    BOTH,
    HIGH,
    Robbed,
    robot_with,
)

APART = {"high": "left", "low": "right"}


def needing(*functions: str, beside: tuple[Task, ...] = ()) -> Robot:
    """Return a robot of two computers; `low` may run on `right` only.

    `beside`: what it does besides the task that needs these functions.
    """
    robot = robot_with()
    high, low = robot.architectures
    (part,) = low.components
    low = replace(low, components=(replace(part, only=("right",)),))
    right = Computer(name="right", capacity={"cpu": 1.0, "memory": 1e9})
    (task,) = robot.tasks
    return replace(
        robot,
        computers=(*robot.computers, right),
        architectures=(high, low),
        tasks=(replace(task, needs=functions), *beside),
    )


def using(name: str, function: str) -> Task:
    """Return a task that uses a function, and needs none."""
    return Task(name=name, actions=(Action(name="use", functions=(function,)),))


class Loop:
    """The loop of such a robot, and computers that are lost when a test says so."""

    def __init__(self, *needs: str, acts: bool = True, beside: str = "") -> None:
        others = (using("other", beside),) if beside else ()
        self.robbed = Robbed(needing(*needs, beside=others), APART)
        self.lost: frozenset[str] = frozenset()
        self.now = 0.0
        self._loop = Adaptation(
            self.robbed.run,
            lambda: replace(self.robbed.situation(), lost=self.lost),
            self.robbed.suspensions,
            acts=acts,
            clock=lambda: self.now,
        )

    def look(self, until: float, *lost: str) -> dict[str, str]:
        """Look five times a second; return the placement then."""
        self.lost = frozenset(lost)
        while self.now < until:
            self._loop.adapt()
            self.now += 0.2
        return dict(self.robbed.run.placement())

    def troubles(self) -> list[str]:
        """Return what status says of tasks."""
        found = [each.what for each in self._loop.deviations]
        return [what for what in found if what.startswith("task")]

    def sentences(self, *words: str) -> list[str]:
        """Return what the journal says with one of these words."""
        entries = (e.what for e in self.robbed.journal.entries())
        return [what for what in entries if any(word in what for word in words)]


def test_a_task_stops_without_what_it_needs_until_it_is_back() -> None:
    loop = Loop("low")
    assert loop.look(2.0) == APART
    assert loop.look(3.0, "right") == {"low": "right"}  # it is there once that is back
    why = "task 'work' needs function 'low', which is missing"
    assert loop.troubles() == [why]
    assert loop.robbed.sentences() == [f"architecture 'high-task' is suspended: {why}"]
    assert loop.look(60.0, "right") == {"low": "right"}
    assert loop.look(62.0) == APART
    assert loop.troubles() == []
    assert loop.sentences("is back", "runs again") == [
        "function 'low' is back",
        "architecture 'high-task' runs again",
    ]


def test_a_task_goes_on_without_what_it_only_uses() -> None:
    loop = Loop("high")
    assert loop.look(10.0, "right") == APART
    assert loop.troubles() == ["task 'work' goes on without function 'low'"]
    assert not loop.robbed.sentences()


def test_what_another_task_uses_goes_on_when_one_stops() -> None:
    loop = Loop("low", beside="high")
    assert loop.look(10.0, "right") == APART
    assert loop.troubles() == ["task 'work' needs function 'low', which is missing"]
    assert not loop.robbed.sentences()


def test_what_several_tasks_go_on_without_is_said_once() -> None:
    loop = Loop(beside="low")
    assert loop.look(10.0, "right") == APART
    assert loop.troubles() == ["tasks 'work' and 'other' go on without function 'low'"]


def test_a_task_that_needs_nothing_is_taken_back_while_another_stops() -> None:
    loop = Loop("low", beside="high")
    loop.look(1.0)
    loop.robbed.suspensions.suspend(["high-task"], "it crashes", loop.now)
    assert loop.look(FIRST + 9.0, "right") == APART


def test_a_moment_without_a_function_stops_nothing() -> None:
    loop = Loop("low")
    loop.look(2.0)
    loop.look(2.4, "right")
    assert loop.look(4.0) == APART
    assert not loop.sentences("task 'work'")


def test_nothing_stops_when_nobody_wants_adaptation() -> None:
    loop = Loop("low", acts=False)
    assert loop.look(10.0, "right") == APART
    assert loop.troubles() == ["task 'work' needs function 'low', which is missing"]


def test_a_computer_that_comes_and_goes_restarts_the_task_less_and_less() -> None:
    """Two minutes: 5 s without it, 5 s with it."""
    loop = Loop("low")
    for at in range(0, 120, 10):
        loop.look(at + 5.0)
        loop.look(at + 10.0, "right")
    assert 2 <= len(loop.sentences("architecture 'high-task' runs again")) <= 4


def test_a_task_stops_when_what_it_needs_is_put_aside_and_all_of_that_comes_back() -> (
    None
):
    loop = Loop("high", "low")
    loop.look(1.0)
    loop.robbed.suspensions.suspend(["low-task"], "it crashes", loop.now)
    assert loop.look(3.0) == {}
    assert loop.look(FIRST) == {}
    assert loop.look(FIRST + 9.0) == APART


def test_needed_functions_come_back_together_or_not_at_all() -> None:
    robot = robot_with()
    (task,) = robot.tasks
    robot = replace(robot, tasks=(replace(task, needs=("high", "low")),))
    robbed = Robbed(robot, {})
    for now in range(100):  # 0.4 are left, but for both 0.8 would have to be
        situation = robbed.situation(0.4)
        missing = frozenset(missing_functions(situation))
        situation = replace(situation, missing=missing)
        robbed.respond(robbed.taking_back, situation, float(now))
    assert robbed.run.placement() == {}
    for now in range(100, 900):
        situation = robbed.situation()
        missing = frozenset(missing_functions(situation))
        situation = replace(situation, missing=missing)
        robbed.respond(robbed.taking_back, situation, float(now))
    assert robbed.run.placement() == BOTH


@pytest.mark.parametrize(
    ("placement", "lost", "missing"),
    [
        (BOTH, [], set()),
        (HIGH, [], {"low"}),
        (BOTH, ["left"], {"high", "low"}),
        ({}, [], {"high", "low"}),
    ],
)
def test_a_function_is_there_when_all_of_an_architecture_is(
    placement: dict[str, str], lost: Iterable[str], missing: set[str]
) -> None:
    situation = replace(
        Robbed(robot_with(), placement).situation(), lost=frozenset(lost)
    )
    assert missing_functions(situation) == missing


def test_what_is_missing_is_said_once() -> None:
    robbed = Robbed(robot_with(), HIGH)
    needs = NeededFunctions(robbed.journal)
    for now in range(10):
        assert not needs.evaluate(robbed.situation(), float(now))
    entries = [e.what for e in robbed.journal.entries()]
    assert entries.count("task 'work' goes on without function 'low'") == 1


def test_a_function_that_no_action_uses_any_more_is_not_said_to_be_back() -> None:
    robbed = Robbed(robot_with(), HIGH)
    needs, situation = NeededFunctions(robbed.journal), robbed.situation()
    for now in range(10):
        needs.evaluate(situation, float(now))
    none = Task(name="none", actions=())
    robot = replace(situation.robot, tasks=(none,))
    needs.evaluate(replace(situation, robot=robot), 10.0)
    assert not needs.deviations()
    assert robbed.journal.entries()[-1].what == "function 'low' is not used any more"
