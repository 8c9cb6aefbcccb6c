"""What is proposed for a running robot, from what its components need now."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pytest
from msgspec.structs import replace

from poise.errors import RobotError
from poise.estimate.online import Drift, Estimate, Reading, RunningEstimate
from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.proposal import propose
from poise.manage.adaptation.situation import Situation
from poise.manage.migration.migration_report import Proposal
from poise.manage.observe.estimates import DemandEstimate
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Objective,
    Robot,
    Task,
)

NOW = {"eye": "left", "mind": "left"}


@pytest.fixture
def robot() -> Robot:
    demands = {"eye": 0.3, "mind": 0.2}
    return Robot(
        name="tiny",
        computers=tuple(
            Computer(name=name, capacity={"cpu": 0.6}) for name in ("left", "right")
        ),
        architectures=(
            Architecture(
                name="all",
                function="all",
                components=tuple(
                    ComponentEntry(name=name, demand={"cpu": cpu}, state=2_000_000)
                    for name, cpu in demands.items()
                ),
                connectors=(
                    Connector(
                        between=(
                            ConnectorEnd("eye", "out"),
                            ConnectorEnd("mind", "into"),
                        ),
                        overhead=1.0,
                    ),
                ),
            ),
        ),
        tasks=(Task(name="work", actions=(Action(name="w", functions=("all",)),)),),
    )


def standing(
    name: str,
    mean: float,
    *,
    expected: float | None = None,
    drift: bool = False,
    error: float | None = 0.01,
) -> DemandEstimate:
    shift = Drift(1.0, 0.1, mean) if drift else None
    estimate = Estimate(mean=mean, p95=mean, error=error, drift=shift)
    return DemandEstimate(
        component=name, computer="left", expected=expected, estimate=estimate
    )


def proposed(
    robot: Robot, now: Mapping[str, str], needs: Iterable[DemandEstimate], move: float
) -> Proposal:
    situation = Situation(robot=robot, placement=now, demand_estimates=tuple(needs))
    return propose(situation, move)


def test_what_is_best_stays(robot: Robot) -> None:
    found = proposed(robot, NOW, [standing("eye", 0.25)], 0.01)
    assert found.steps == ()
    assert found.shifted == {}
    assert found.placement == NOW
    assert found.proven


def test_a_demand_shifts_as_the_mean_does(robot: Robot) -> None:
    """The profile said 0.25 of the 0.3 counted with; 0.5 now is twice as much."""
    grown = standing("eye", 0.5, expected=0.25, drift=True)
    found = proposed(robot, NOW, [grown], 0.01)
    assert counted(found) == pytest.approx({"eye": 0.6})
    assert found.now.shortage > found.then.shortage
    assert all(step.source and step.target for step in found.steps)
    assert found.placement["eye"] != found.placement["mind"]


def test_a_handler_that_does_not_end_is_counted_with_within_3_s(robot: Robot) -> None:
    """It took 2 % for 20 jobs a second, and then all of the 0.6 cores there are."""
    running, cpu = RunningEstimate(), 0.0
    for k in range(125 + 15):
        cpu += 0.6 * 0.2 if k >= 125 else 0.02 * 0.2
        running.update(Reading(0.2 * k, cpu, 0.0, 4 * k, min(4 * k, 4 * 125)))
    now = running.estimate()
    assert now is not None
    eye = replace(standing("eye", 0.0), estimate=now)
    found = proposed(robot, NOW, [eye], 0.01)
    assert counted(found) == pytest.approx({"eye": 0.6})
    assert found.placement["eye"] != found.placement["mind"]


def test_what_needs_more_than_was_counted_with_is_believed(robot: Robot) -> None:
    """(0.5 + 0.01) * 1.05, as no profile says how mean and demand belong together."""
    found = proposed(robot, NOW, [standing("eye", 0.5)], 0.01)
    assert counted(found) == pytest.approx({"eye": 0.5355})
    assert str(found.shifted["eye"]) == (
        "50.0% ± 1.0% of a core now: counted as 53.6%"  # 53.55
    )


@pytest.mark.parametrize("error", [None, 0.3])
def test_what_is_not_certain_yet_is_not_believed(
    robot: Robot, error: float | None
) -> None:
    found = proposed(robot, NOW, [standing("eye", 0.5, error=error)], 0.01)
    assert found.shifted == {}


def test_a_move_must_gain_more_than_it_costs(robot: Robot) -> None:
    """Together F is 0.5 x communication 0 + 0.5 x spread; dear moves change nothing."""
    apart = {"eye": "left", "mind": "right"}
    assert proposed(robot, apart, [], 0.0).steps
    assert not proposed(robot, apart, [], 1.0).steps


def test_no_more_is_believed_than_a_computer_can_give(robot: Robot) -> None:
    """It seems to need 90 % of a core, where a computer has 60 %: one for itself."""
    found = proposed(robot, NOW, [standing("eye", 0.9)], 0.01)
    assert counted(found) == {"eye": 0.6}
    assert found.placement["eye"] != found.placement["mind"]
    told = str(found.shifted["eye"])
    assert told.endswith("counted as 60.0%, all that any computer can give it")


def test_a_component_uses_one_core_at_most_and_a_command_all(robot: Robot) -> None:
    """Both computers have four cores of half the reference computer's speed."""
    large = replace(
        robot,
        computers=tuple(
            replace(each, capacity={"cpu": 4.0}, speed=0.5) for each in robot.computers
        ),
    )
    (architecture,) = large.architectures
    eye, mind = architecture.components
    command = replace(architecture, components=(replace(eye, command=("see",)), mind))
    commanded = replace(large, architectures=(command,))
    needy = [standing("eye", 3.0)]
    assert counted(proposed(large, NOW, needy, 0.01)) == {"eye": 0.5}
    assert counted(proposed(commanded, NOW, needy, 0.01)) == {"eye": 2.0}


def test_what_fits_nowhere_is_said(robot: Robot) -> None:
    """CPU is shared, memory is not."""
    needy = [standing("eye", 0.6), standing("mind", 0.6)]
    large = robot.with_components(
        lambda c: replace(c, demand={**c.demand, "memory": 8e8})
    )
    crowded = replace(
        large,
        computers=(replace(robot.computers[0], capacity={"cpu": 2.0, "memory": 1e9}),),
    )
    with pytest.raises(RobotError, match="has no placement any more: ") as said:
        proposed(crowded, NOW, needy, 0.01)
    assert "mind needs 60.0% ± 1.0% of a core now" in str(said.value)


def counted(proposal: Proposal) -> dict[str, float]:
    return {name: need.counted for name, need in proposal.shifted.items()}


@pytest.mark.parametrize("communication", [0.5, 1e3, 1e6])
def test_no_weight_of_communication_lets_cpu_be_short(
    robot: Robot, communication: float
) -> None:
    heavy = replace(robot, objective=Objective(communication=communication))
    needs = standing("eye", 0.5, drift=True), standing("mind", 0.3, drift=True)
    situation = Situation(robot=heavy, placement=NOW, demand_estimates=needs)
    decision = decide(situation)
    assert decision.acts
    assert decision.gain == pytest.approx(0.249075)
    assert propose(situation).then.shortage == 0.0
