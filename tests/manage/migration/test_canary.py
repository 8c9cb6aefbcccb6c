"""When new code that is watched comes back, and when it stays."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.deploy.desired import Incarnation
from poise.manage.migration import canary
from poise.manage.migration.canary import Canaries
from poise.manage.migration.migration_report import MigrationReport
from poise.wire.records.status_records import (
    ComponentStatus,
    ContainerHealth,
    Summary,
    TimerStatus,
)

OLD = Incarnation(component="eye", computer="left", epoch=1)
NEW = replace(OLD, epoch=2, code="b" * 64)


def timer(releases: int, missed: int) -> TimerStatus:
    return TimerStatus(
        name="look",
        period=0.1,
        deadline=0.1,
        releases=releases,
        missed=missed,
        lateness=Summary(),
        duration=Summary(),
    )


class Robot:
    """A component on one computer, as its manager and its agent see it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.placed = {"eye": OLD}
        self.timer = timer(100, 0)
        self.health = ContainerHealth(name="eyes", state="running", since=0.0)
        self.state: Any = "active"
        self.notes: list[str] = []
        self.restarted: dict[str, Incarnation] = {}
        self.gives_state = self.restarts = True
        run: Any = self
        self.clock = SimpleNamespace(now=lambda: self.now)
        self.unheard: dict[str, float] = {}
        self.agents = SimpleNamespace(out_of_reach=lambda: self.unheard)
        self.journal = SimpleNamespace(note=lambda _, what: self.notes.append(what))
        monkeypatch.setattr(canary, "plan_return", self._returned)
        monkeypatch.setattr(canary, "start_together", self._restarted)
        self.canaries = Canaries(run)

    def reported(self, wanted: Incarnation) -> ComponentStatus | None:
        component = ComponentStatus(
            name="eye",
            epoch=self.placed["eye"].epoch,
            state=self.state,
            timers=(self.timer,),
        )
        return component if component.epoch == wanted.epoch else None

    def health_of(self, _: Incarnation) -> ContainerHealth:
        return self.health

    def replace(self) -> None:
        """Let new code take over, which is watched for 30 s."""

        def migrate() -> MigrationReport:
            self.placed["eye"], self.timer = NEW, timer(0, 0)
            return MigrationReport(what="eye", before={}, after={}, committed=True)

        self.canaries.begin("eye", 30.0, migrate)

    def _returned(self, _: object, before: Incarnation) -> Any:
        def run() -> MigrationReport:
            if self.gives_state:
                self.placed["eye"] = replace(before, epoch=3)
            report = MigrationReport(what="eye", before={}, after={})
            return replace(report, committed=self.gives_state)

        return SimpleNamespace(run=run)

    def _restarted(
        self, _: object, where: dict[str, str], instead: dict[str, Incarnation]
    ) -> bool:
        assert where == {"eye": "left"}
        self.restarted = instead
        return self.restarts


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(monkeypatch)


def test_code_that_works_stays(robot: Robot) -> None:
    robot.replace()
    robot.timer = timer(100, 2)  # less than three, as the move may have delayed it
    assert robot.canaries.under_way() == (
        "new code of component 'eye' is watched for 30 s more",
    )
    assert not robot.canaries.check()
    for robot.now in (29.7, 30.0):  # until it is checked again, it is watched
        assert robot.canaries.under_way()[0].endswith("is watched for 1 s more")
    assert not robot.canaries.check()
    assert not robot.canaries.under_way()
    assert robot.notes[-1] == (
        "new code of component 'eye' has worked for 30 s: it stays"
    )
    robot.timer = timer(200, 100)
    assert not robot.canaries.check()


def test_code_that_misses_more_deadlines_gives_its_state_back(robot: Robot) -> None:
    robot.timer = timer(100, 10)
    robot.replace()
    robot.timer = timer(20, 4)  # a fifth: 20 %, before it were 10 %
    assert robot.canaries.check()
    assert robot.placed["eye"].code == ""
    assert not robot.restarted
    (deviation,) = robot.canaries.deviations()
    assert deviation.what == (
        "component 'eye' returns to its previous code: timer 'look' missed 4 of 20 "
        "deadlines, and 10% before"
    )
    robot.now = 61.0
    assert not [*robot.canaries.deviations()]


def test_code_that_misses_no_more_deadlines_than_before_stays(robot: Robot) -> None:
    robot.timer = timer(100, 50)
    robot.replace()
    robot.timer = timer(20, 10)
    assert not robot.canaries.check()


def test_code_that_crashed_comes_back_from_a_checkpoint(robot: Robot) -> None:
    robot.replace()
    robot.state = "unconfigured"
    robot.health = replace(robot.health, state="restarting")
    assert robot.canaries.check()
    assert robot.restarted == {"eye": OLD}
    assert not robot.canaries.under_way()


def test_code_that_restarted_between_two_looks_comes_back(robot: Robot) -> None:
    robot.health = replace(robot.health, restarts=3)  # before it came
    robot.replace()
    assert not robot.canaries.check()
    robot.health = replace(robot.health, restarts=4)
    robot.gives_state = False
    assert robot.canaries.check()
    assert robot.restarted == {"eye": OLD}


def test_code_that_cannot_come_back_is_not_said_to_do_so(robot: Robot) -> None:
    robot.replace()
    robot.gives_state = robot.restarts = False
    robot.health = replace(robot.health, state="stopped")
    assert robot.canaries.check()
    (deviation,) = robot.canaries.deviations()
    assert deviation.what == (
        "the new code of component 'eye' has failed (its container is stopped), and "
        "its previous code did not start"
    )
    assert robot.notes[-1] == deviation.what


def test_code_that_nobody_can_be_told_is_back_is_not_restarted(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manager is cut off, and its successor may undo it: no bug, and no restart."""

    def fail() -> MigrationReport:
        raise RunError("no agent could be told")

    robot.replace()
    robot.timer = timer(20, 9)
    monkeypatch.setattr(canary, "plan_return", lambda *_: SimpleNamespace(run=fail))
    assert robot.canaries.check()
    assert robot.notes[-1].endswith("; no agent could be told")
    assert not robot.restarted
    assert not robot.canaries.check()
    (shown,) = robot.canaries.deviations()
    assert shown.what == robot.notes[-1]


def test_code_that_moves_is_not_to_blame_for_what_crashed_there_before(
    robot: Robot,
) -> None:
    """Its container there restarted three times before it came, and once since."""
    robot.replace()
    assert not robot.canaries.check()
    robot.placed["eye"] = replace(NEW, computer="right", epoch=3)
    robot.health = replace(robot.health, restarts=3)
    assert not robot.canaries.check()
    assert not robot.canaries.check()
    robot.health = replace(robot.health, restarts=4)
    assert robot.canaries.check()
    assert robot.placed["eye"].code == ""


def test_code_whose_computer_was_lost_has_not_worked_meanwhile(robot: Robot) -> None:
    robot.replace()
    robot.now, robot.unheard = 20.0, {"left": 0.0}
    assert not robot.canaries.check()
    robot.now, robot.unheard = 35.0, {}
    robot.placed["eye"] = replace(NEW, computer="right", epoch=3)
    assert not robot.canaries.check()
    robot.now = 64.0
    assert not robot.canaries.check()
    assert robot.canaries.under_way()
    robot.now = 65.0
    assert not robot.canaries.check()
    assert robot.notes[-1].endswith("it stays")


def test_code_that_is_replaced_again_is_watched_no_more(robot: Robot) -> None:
    robot.replace()
    robot.placed["eye"] = replace(NEW, code="c" * 64)
    robot.state = "failed"
    assert not robot.canaries.check()
    assert not robot.canaries.under_way()
