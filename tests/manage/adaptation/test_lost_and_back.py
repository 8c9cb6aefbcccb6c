"""What restarts from a lost computer, and what goes back there when it is worth it."""

from __future__ import annotations

from msgspec.structs import replace

from poise.manage.adaptation.loop import Adaptation
from poise.manage.migration.transition_run import start_together
from poise.manage.shortages.suspension import CALM
from poise.model.robot import Computer
from tests.manage.adaptation.shortages.test_suspension import BOTH, Robbed, robot_with


class Returning(Robbed):
    """A robot whose computer `right` was lost, and is back."""

    def __init__(self, cpu: float) -> None:
        names, capacity = ("left", "right"), {"cpu": cpu, "memory": 1e9}
        computers = tuple(Computer(name=n, capacity=capacity) for n in names)
        robot = replace(robot_with(), computers=computers)
        free = tuple(replace(a, home=None) for a in robot.architectures)
        robot = replace(robot, architectures=free)
        super().__init__(robot, BOTH)
        self.now, self.lost = 0.0, frozenset({"right"})
        self.loop = Adaptation(
            self.run,
            lambda: replace(self.situation(), lost=self.lost, loads={}),
            self.suspensions,
            clock=lambda: self.now,
        )
        self.look(0.0)
        self.lost = frozenset()
        self.look(1.0)

    def look(self, now: float) -> None:
        self.now = now
        self.loop.adapt()

    def said(self) -> list[str]:
        whats = (entry.what for entry in self.journal.entries())
        return [what for what in whats if "may be used again" in what]


def test_what_is_short_moves_there() -> None:
    back = Returning(cpu=0.6)
    back.look(1.0 + CALM)
    (said,) = back.said()
    assert "cores of work more, for 0.32 core-seconds" in said
    assert "transition of 1 step" in [entry.what for entry in back.journal.entries()]


def test_what_runs_well_is_not_disturbed() -> None:
    back = Returning(cpu=1.0)
    back.look(1.0 + CALM)
    back.look(100.0)
    assert back.run.placement() == BOTH
    assert back.said() == [
        "'right' may be used again; every running component has the CPU that it needs"
    ]


def test_what_restarts_without_the_state_that_was_to_be_kept_is_said() -> None:
    robot = robot_with().with_components(
        lambda c: replace(c, checkpoint=1.0 if c.name == "low" else 0.0)
    )
    robbed = Robbed(robot)
    start_together(robbed.run, {"low": "left", "high": "left"})
    (wrong,) = (each.what for each in robbed.journal.entries() if each.kind == "wrong")
    why = "this manager has no copy of its checkpoint"
    lost = f"without the state that it had on 'left': {why}"
    assert wrong == f"component 'low' started {lost}"
    assert robbed.run.lost_states["low"].what == wrong
