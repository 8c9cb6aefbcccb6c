"""Reactive and deliberative architectures stay as they are, whatever is asked.

That `plan --fewer` keeps them is in `tests/plan/test_choices.py`; that no architecture
of theirs is suspended in `tests/manage/adaptation/shortages/test_suspension.py`.
"""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import UsageError
from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.placement_responders import plan_failover
from poise.manage.adaptation.situation import Situation
from poise.manage.migration.move import plan_alternative, plan_move, plan_replacement
from poise.model.policy import Policy
from poise.model.robot import Computer, Robot
from tests.manage.adaptation.shortages.test_suspension import BOTH, Robbed, robot_with
from tests.manage.adaptation.test_actions import take

pytestmark = pytest.mark.parametrize("layer", ["reactive", "deliberative"])
RIGHT = Computer(name="right", capacity={"cpu": 1.0, "memory": 1e9})


def robot_of_two(layer: str) -> Robot:
    """Return a robot with room on a second computer; all is at home on `left`."""
    robot = robot_with(layer=layer)
    return replace(robot, computers=(*robot.computers, RIGHT))


def commands(robot: Robot) -> Robot:
    """Return the robot with command lines, whose moves need no agents that obey."""
    return robot.with_components(
        lambda component: replace(component, implementation="", command=("./go",))
    )


def test_a_move_is_refused(layer: str) -> None:
    robbed = Robbed(robot_of_two(layer))
    with pytest.raises(UsageError, match=f"{layer} layer, which does not move"):
        plan_move(robbed.run, "low", "right").run()
    assert robbed.run.placement() == BOTH


def test_a_person_may_force_a_move_and_it_stays_there(layer: str) -> None:
    robbed = Robbed(commands(robot_of_two(layer)))
    robbed.agents._statuses |= type(robbed.agents)("right")._statuses
    assert plan_move(robbed.run, "low", "right", force=True).run().committed
    now = robbed.run.placement()
    assert now == {"high": "left", "low": "right"}
    problem = plan.problem_of(robbed.run.robot, "work", present=now)
    assert plan.solve(problem).placement == now


def test_an_implementation_is_not_replaced(layer: str) -> None:
    robbed = Robbed(robot_of_two(layer))
    with pytest.raises(UsageError, match=f"{layer} layer, which stays as it is"):
        plan_replacement(robbed.run, "low", "other:Class").run()


def test_an_architecture_is_not_replaced(layer: str) -> None:
    robot = robot_of_two(layer)
    high, low = robot.architectures
    other = replace(
        low, name="spare", components=(replace(low.components[0], name="spare"),)
    )
    robbed = Robbed(replace(robot, architectures=(high, low, other)))
    with pytest.raises(UsageError, match=f"{layer} layer, which stays as it is"):
        plan_alternative(robbed.run, "low-task", "spare").run()


def test_an_overload_moves_none(layer: str) -> None:
    robbed = Robbed(robot_of_two(layer))
    decision = decide(robbed.situation(0.5, "high", "low"))
    assert not decision.acts
    sequencing = Robbed(robot_of_two("sequencing"))
    assert decide(sequencing.situation(0.5, "high", "low")).acts


def test_a_lost_computer_takes_them_with_it(layer: str) -> None:
    robbed = Robbed(robot_of_two(layer))
    situation: Situation = replace(robbed.situation(), lost=frozenset({"left"}))
    found = plan_failover(situation, {"left"})
    assert not found.placement
    assert set(found.missing) == {"high", "low"}
    assert found.missing["low"] == f"it belongs to the {layer} layer, which stays"


def test_a_policy_moves_none_even_by_force(layer: str) -> None:
    policy = Policy(
        name="p", for_each="component", when="not (name == 'high')", do="move"
    )
    policy = replace(policy, to="right", force=True)
    with pytest.raises(UsageError, match=f"{layer} layer, which does not move"):
        take(Robbed(robot_of_two(layer)), policy)
