"""What restarts from a lost computer, and what goes back there when it is worth it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.adaptation.loop import Adaptation
from poise.manage.migration.transition_run import start_together
from poise.manage.shortages.suspension import CALM
from poise.model.robot import Computer
from poise.wire.records.request_records import CheckpointCopy
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
        self.away: frozenset[str] = frozenset()
        self.loop = Adaptation(
            self.run,
            lambda: replace(self.situation(), lost=self.lost, away=self.away, loads={}),
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


def with_a_checkpoint() -> Robbed:
    """Return the robot, whose component 'low' keeps checkpoints."""
    robot = robot_with().with_components(
        lambda c: replace(c, checkpoint=1.0 if c.name == "low" else 0.0)
    )
    return Robbed(robot)


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


def test_what_is_out_of_reach_is_not_back() -> None:
    """Its heartbeats come again, and its agent cannot be asked."""
    back = Returning(cpu=1.0)
    back.away = frozenset({"right"})
    back.look(1.0 + CALM)
    assert back.said() == []
    back.away = frozenset()
    back.look(2.0 + CALM)
    assert len(back.said()) == 1


def test_what_restarts_without_the_state_that_was_to_be_kept_is_said() -> None:
    robbed = with_a_checkpoint()
    start_together(robbed.run, {"low": "left", "high": "left"})
    (wrong,) = (each.what for each in robbed.journal.entries() if each.kind == "wrong")
    why = "this manager has no copy of its checkpoint"
    lost = f"without the state that it had on 'left': {why}"
    assert wrong == f"component 'low' started {lost}"
    assert robbed.run.lost_states["low"].what == wrong


def test_what_goes_on_on_a_lost_computer_has_lost_no_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its lease may last: then nothing starts elsewhere."""
    robbed = with_a_checkpoint()
    run = robbed.run

    def last(*_: object) -> None:
        raise RunError("components of 'left' may still be at work")

    with monkeypatch.context() as patch:
        patch.setattr(run, "end_left_behind", last)
        assert not start_together(run, {"low": "left"}, lost=["left"])
    assert run.lost_states == {}
    assert start_together(run, {"low": "left"}, lost=["left"])
    assert run.lost_states.keys() == {"low"}


def test_what_goes_on_without_a_checkpoint_that_was_refused_has_lost_no_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The computer that was to take it was cut off as well, for a moment."""
    robbed = with_a_checkpoint()
    run = robbed.run
    run.agents.checkpoints.note(
        CheckpointCopy(
            component="low", epoch=run.placed["low"].epoch, data=b"state", age=0.0
        )
    )
    monkeypatch.setattr(run.agents, "keep_checkpoint", lambda *_: "no answer")

    def come_to_nothing(*_: object) -> None:
        raise RunError("computer 'left' has been out of reach")

    with monkeypatch.context() as patch:
        patch.setattr(run, "wait", come_to_nothing)
        assert not start_together(run, {"low": "left"}, lost=["left"])
    assert run.lost_states == {}
    assert start_together(run, {"low": "left"}, lost=["left"])
    assert "did not take the checkpoint (no answer)" in run.lost_states["low"].what


def test_what_stays_where_it_was_keeps_its_checkpoints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those of what was to restart elsewhere, and did not, counted for ever."""
    robbed = with_a_checkpoint()
    run, checkpoints = robbed.run, robbed.run.agents.checkpoints
    before = run.placed["low"].epoch

    def note(epoch: int, data: bytes | None) -> None:
        checkpoints.note(
            CheckpointCopy(component="low", epoch=epoch, data=data, age=0.0)
        )

    def come_to_nothing(*_: object) -> None:
        (coming,) = run.desired.coming
        note(coming.epoch, b"old")  # its agent has it in its folder
        raise RunError("'left' is reached again")

    note(before, b"old")
    with monkeypatch.context() as patch:
        patch.setattr(run, "wait", come_to_nothing)
        assert not start_together(run, {"low": "left"}, lost=["left"])
    assert run.placed["low"].epoch == before
    note(before, b"new")
    note(before, None)  # it holds still
    kept = checkpoints.get("low", before)
    assert kept is not None
    assert kept.data == b"new"
    assert checkpoints.get("low", before + 1) is None


def test_the_checkpoint_of_what_has_moved_is_forgotten() -> None:
    robbed = Robbed(robot_with())
    run, checkpoints = robbed.run, robbed.run.agents.checkpoints
    before = run.placed["low"].epoch
    checkpoints.note(
        CheckpointCopy(component="low", epoch=before, data=b"old", age=0.0)
    )
    assert start_together(run, {"low": "left"})
    assert checkpoints.get("low", before) is None
