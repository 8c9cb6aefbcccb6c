"""What policies do, and what they must not."""

from __future__ import annotations

from functools import partial

import pytest
from msgspec.structs import replace

from poise.errors import RunError, UsageError
from poise.manage.adaptation.actions import Actions
from poise.manage.adaptation.loop import Adaptation
from poise.manage.adaptation.policies import Policies, Symptom
from poise.manage.adaptation.policy_values import values_of
from poise.manage.adaptation.when_to_act import BUDGET, MoveLimits
from poise.manage.migration.migration_report import TransitionStep
from poise.model.policy import Policy, TimerValues
from poise.model.robot import Computer
from tests.manage.adaptation.shortages.test_suspension import (
    BOTH,
    HIGH,
    Robbed,
    robot_with,
)

RIGHT = Computer(name="right", capacity={"cpu": 0.3, "memory": 1e9})


def take(
    robbed: Robbed, policy: Policy, limits: MoveLimits | None = None, now: float = 0.0
) -> None:
    """Carry out the action of a policy about the first subject that it finds."""
    situation = replace(robbed.situation(), now=now)
    policies = Policies([replace(policy, lasts=0.0)])
    symptom = policies.evaluate(partial(values_of, situation), now)[0]
    actions = Actions(robbed.run, robbed.suspensions, limits or MoveLimits(), policies)
    actions.act(symptom, situation)


def about(name: str, **keys: object) -> Policy:
    """Return a policy about one component."""
    known = {"name": "p", "for_each": "component", "when": f"name == '{name}'"}
    return Policy(**{**known, **keys})  # type: ignore[arg-type] # of a test


def test_the_architecture_of_a_component_is_put_aside() -> None:
    robbed = Robbed(robot_with())
    take(robbed, about("low", do="suspend"))
    assert robbed.run.placement() == HIGH
    (deviation,) = robbed.suspensions.deviations()
    assert deviation.what.startswith("architecture 'low-task' is suspended: ")


def test_of_a_computer_the_lowest_priority_is_put_aside() -> None:
    robbed = Robbed(robot_with())
    take(robbed, Policy(name="p", for_each="computer", when="not lost", do="suspend"))
    assert robbed.run.placement() == HIGH


def test_of_equal_priorities_a_computer_keeps_all() -> None:
    robbed = Robbed(robot_with(1, 1))
    policy = Policy(name="p", for_each="computer", when="not lost", do="suspend")
    with pytest.raises(RunError, match="no architecture on 'left' has a lower"):
        take(robbed, policy)
    assert robbed.run.placement() == BOTH


@pytest.mark.parametrize("layer", ["reactive", "deliberative"])
def test_other_layers_are_not_put_aside(layer: str) -> None:
    robbed = Robbed(robot_with(layer=layer))
    with pytest.raises(UsageError, match=f"{layer} layer"):
        take(robbed, about("low", do="suspend", force=True))
    assert robbed.run.placement() == BOTH


def test_a_restart_begins_a_new_incarnation_there() -> None:
    robbed = Robbed(robot_with())
    take(robbed, about("low", do="restart"))
    assert robbed.run.placement() == BOTH
    assert robbed.run.placed["low"].epoch == 1
    assert robbed.run.placed["high"].epoch == 0


def test_what_is_not_at_work_any_more_is_not_restarted() -> None:
    """Its timer was late a moment ago, so a policy still sees that."""
    robbed = Robbed(robot_with(), HIGH)
    late = TimerValues(
        name="low.t", component="low", computer="left", timer="t", late=True
    )
    policy = Policy(name="p", for_each="timer", when="late", do="restart")
    symptom = Symptom(policy=policy, what="it is late", values=late)
    actions = Actions(robbed.run, robbed.suspensions, MoveLimits(), Policies([policy]))
    with pytest.raises(RunError, match="component 'low' is not at work"):
        actions.act(symptom, robbed.situation())


def robbed_of_two() -> Robbed:
    """Return one that has a second, small computer."""
    robot = robot_with()
    return Robbed(replace(robot, computers=(*robot.computers, RIGHT)))


def test_a_move_keeps_the_limits_of_its_target() -> None:
    with pytest.raises(UsageError, match="does not fit on 'right'"):
        take(robbed_of_two(), about("low", do="move", to="right"))


def test_a_move_keeps_the_budget_and_does_not_return_too_soon() -> None:
    limits, policy = MoveLimits(), about("low", do="move", to="right")
    back = TransitionStep("low", "right", "left")
    limits.note([back], 0.0)
    with pytest.raises(RunError, match="'low' left 'right' only recently"):
        take(robbed_of_two(), policy, limits, 1.0)
    limits.note([back] * BUDGET, 1.0)
    with pytest.raises(RunError, match="too many moves in the last minute"):
        take(robbed_of_two(), policy, limits, 2.0)


def test_what_has_no_alternative_is_not_replaced() -> None:
    with pytest.raises(UsageError, match="'low-task' has no alternative"):
        take(Robbed(robot_with()), about("low", do="replace"))


def test_the_loop_says_what_a_policy_saw_and_what_came_of_it() -> None:
    robot = robot_with()
    policies = (about("low", do="restart", lasts=0.0, cool_down=60.0),)
    robbed = Robbed(replace(robot, policies=policies))
    now = [0.0]
    loop = Adaptation(
        robbed.run, robbed.situation, robbed.suspensions, clock=lambda: now[0]
    )
    loop.adapt()
    assert robbed.run.placed["low"].epoch == 1
    (entry,) = [e for e in robbed.journal.entries() if "policy" in e.what]
    assert entry.what == "policy 'p': restart 'low': component 'low': name == 'low'"
    (seen,) = entry.facts["policies"]
    assert seen["saw"]["computer"] == "left"
    now[0] = 59.0
    loop.adapt()
    assert robbed.run.placed["low"].epoch == 1
    now[0] = 60.0
    loop.adapt()
    assert robbed.run.placed["low"].epoch == 2


def test_an_action_that_fails_is_said_and_the_loop_goes_on() -> None:
    policies = (about("low", do="replace", lasts=0.0, cool_down=60.0),)
    robbed = Robbed(replace(robot_with(), policies=policies))
    loop = Adaptation(
        robbed.run, robbed.situation, robbed.suspensions, clock=lambda: 0.0
    )
    loop.adapt()
    (entry,) = [e for e in robbed.journal.entries() if e.kind == "failed"]
    assert entry.what.endswith("architecture 'low-task' has no alternative")


def test_what_is_where_a_policy_moves_it_is_left_alone() -> None:
    policies = (about("low", do="move", to="left", lasts=0.0),)
    robbed = Robbed(replace(robot_with(), policies=policies))
    loop = Adaptation(
        robbed.run, robbed.situation, robbed.suspensions, clock=lambda: 0.0
    )
    loop.adapt()
    assert not [e for e in robbed.journal.entries() if "policy" in e.what]
