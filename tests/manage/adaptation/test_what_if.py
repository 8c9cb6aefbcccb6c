"""What a move would change, before anything happens."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.manage.adaptation.move_forecast import alternatives, check_move, what_if
from poise.manage.adaptation.proposal import propose
from poise.model.robot import Architecture, Computer, Robot
from poise.session.render.tables import what_if_lines
from tests.manage.adaptation.conftest import Make


def test_says_loads_limits_and_what_the_move_costs(situation: Make) -> None:
    seen = what_if(replace(situation(), downtimes={"a": 0.5}), "a", "right")
    assert (seen.source, seen.target) == ("left", "right")
    before, after = seen.loads["left"]
    gained = seen.loads["right"][1] - seen.loads["right"][0]
    assert before - after == pytest.approx(gained)
    assert gained == pytest.approx(0.2)
    assert not seen.breaks
    assert seen.downtime == 0.5
    assert seen.cost == pytest.approx(0.3 + 0.2 * 0.5)
    assert any("without the cost of the move" in line for line in what_if_lines(seen))


def test_says_which_limits_the_move_would_break(situation: Make, two: Robot) -> None:
    small = Computer(name="right", capacity={"cpu": 0.1})
    robot = replace(two, computers=(two.computers[0], small))
    seen = what_if(situation(robot=robot), "a", "right")
    assert any("right" in limit for limit in seen.breaks)
    assert any("refused" in line for line in what_if_lines(seen))


@pytest.mark.parametrize("background", [{}, {"right": 0.5}])
def test_says_the_same_of_the_present_as_a_balance(
    situation: Make, background: dict[str, float]
) -> None:
    """Other programs may take all the CPU of a computer."""
    now = situation({"a": "left", "b": "right"}, background=background)
    seen, proposal = what_if(now, "b", "left"), propose(now)
    assert (seen.now, seen.trouble) == (proposal.now, proposal.trouble)
    assert seen.usable["right"] == pytest.approx(0.0 if background else 0.5)
    assert (seen.then.total < seen.now.total) == bool(background)


@pytest.mark.parametrize(
    ("component", "computer"), [("none", "right"), ("a", "none"), ("a", "left")]
)
def test_refuses_what_is_no_move(
    situation: Make, component: str, computer: str
) -> None:
    with pytest.raises(UsageError):
        what_if(situation(), component, computer)


def test_says_what_else_could_be_done_and_what_that_would_cost(situation: Make) -> None:
    """Of 0.5 cores others take 0.2 and want 0.24: 0.26 are left for 0.4."""
    stays, *moves = alternatives(
        replace(situation(background={"left": 0.2}), downtimes={"b": 1.0})
    )
    assert (stays.what, stays.cost) == ("stay", 0.0)
    assert stays.short == pytest.approx(0.14)
    assert not stays.breaks  # CPU is shared
    assert {each.what for each in moves} == {
        "move a from left to right",
        "move b from left to right",
    }
    costs = {each.what.split()[1]: each.cost for each in moves}
    assert costs == pytest.approx({"a": 0.3 + 0.2 * 0.05, "b": 0.3 + 0.2 * 1.0})
    for each in moves:
        assert each.short == pytest.approx(0.0)
        assert not each.breaks
        assert each.total < stays.total


def test_a_component_that_must_stay_is_no_alternative(
    situation: Make, two: Robot
) -> None:
    robot = two.with_components(
        lambda c: replace(c, movable=False) if c.name == "a" else c
    )
    stays, *moves = alternatives(situation(robot=robot))
    assert [each.what.split()[1] for each in moves] == ["b"]
    assert stays.short == 0.0


def test_force_is_offered_only_where_it_helps(situation: Make, two: Robot) -> None:
    """A computer that the file does not allow is for the move itself to refuse."""
    small = Computer(name="right", capacity={"cpu": 0.1})
    robot = replace(two, computers=(two.computers[0], small))
    with pytest.raises(UsageError, match="--force"):
        check_move(situation(robot=robot), "a", "right")
    held = replace(robot, architectures=tuple(map(_held, robot.architectures)))
    check_move(situation(robot=held), "a", "right")


def _held(architecture: Architecture) -> Architecture:
    components = [replace(each, only=("left",)) for each in architecture.components]
    return replace(architecture, components=tuple(components))


def test_components_that_share_a_computer_move_together(
    situation: Make, two: Robot
) -> None:
    together = replace(two, together=(("a", "b"),))
    stays, move = alternatives(situation(robot=together))
    assert not stays.breaks
    assert move.what == "move a from left to right, move b from left to right"
    assert not move.breaks
    assert move.cost == pytest.approx(2 * (0.3 + 0.2 * 0.05))


def test_a_move_that_splits_components_is_refused_unless_forced(
    situation: Make, two: Robot
) -> None:
    together = situation(robot=replace(two, together=(("a", "b"),)))
    seen = what_if(together, "a", "right")
    assert seen.breaks == ("a, b must share a computer: a is on right, b is on left",)
    with pytest.raises(UsageError, match=r"must share a computer.*--force"):
        check_move(together, "a", "right")


def test_what_a_forced_move_has_split_is_joined_again(
    situation: Make, two: Robot
) -> None:
    together = replace(two, together=(("a", "b"),))
    split = situation({"a": "left", "b": "right"}, robot=together)
    stays, *moves = alternatives(split)
    assert "must share a computer" in stays.breaks
    assert {each.what for each in moves} == {
        "move a from left to right",
        "move b from right to left",
    }
    assert not any(each.breaks for each in moves)
    proposal = propose(split)
    assert "must share a computer" in proposal.trouble
    assert len({*proposal.placement.values()}) == 1


def test_a_computer_may_have_no_cpu(situation: Make, two: Robot) -> None:
    store = Computer(name="right", capacity={"memory": 1e9})
    robot = replace(two, computers=(two.computers[0], store))
    stays, *moves = alternatives(situation(robot=robot))
    assert stays.short == 0.0
    assert [each.short for each in moves] == pytest.approx([0.2, 0.2])
