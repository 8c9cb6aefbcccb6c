"""What was to end on a computer that is out of reach does not begin beside itself."""

from __future__ import annotations

import pytest
from msgspec import structs

from poise.manage.control_socket.commands import ReplaceCommand
from poise.model.robot import Action, Architecture, ComponentEntry, Robot, Task
from poise.simulation.faults import SimulatedFault
from tests.simulation import clients
from tests.simulation.conftest import small_scenario
from tests.simulation.simulated_run import Scenario, simulate

_PLACEMENT = {"camera": "c", "motor": "a", "map": "c"}


def _alone(
    function: str, name: str, *only: str, cpu: float = 0.2, movable: bool = True
) -> Architecture:
    """Return an architecture of one component, called as that is."""
    entry = ComponentEntry(
        name=name,
        implementation=f"small:{name}",
        demand={"cpu": cpu, "memory": 1e6},
        only=only,
        movable=movable,
    )
    quality = 0.5 if name == "camera" else 1.0
    return Architecture(
        name=name, function=function, components=(entry,), quality=quality
    )


def _seeing_again(*more: Architecture, movable: bool = False) -> Scenario:
    """Return a robot whose camera ends on c at 5 s, and is needed again from 9 s."""
    all_day = ("acting", "mapping")
    again = Action(name="again", functions=("seeing", *all_day), limit=60.0)
    rest = Action(name="rest", functions=all_day, limit=4.0, on_failure=again)
    look = Action(
        name="look", functions=("seeing", *all_day), limit=5.0, on_failure=rest
    )
    small = small_scenario(20.0)
    robot = Robot(
        name="left",
        folder="/robot",
        computers=small.robot.computers,
        architectures=(
            _alone("seeing", "camera", "b", "c", movable=movable),
            _alone("acting", "motor", "a"),
            # so that the camera would begin on b
            _alone("mapping", "map", "c", cpu=1.6),
            *more,
        ),
        tasks=(Task(name="work", actions=(look,)),),
    )
    return structs.replace(small, robot=robot, placement=_PLACEMENT, moves=False)


@pytest.mark.slow
@pytest.mark.parametrize("movable", [False, True])
def test_an_alternative_does_not_begin_beside_itself(
    monkeypatch: pytest.MonkeyPatch, *, movable: bool
) -> None:
    """Its computer is out of reach of the manager, but not of another agent."""
    scenario = _seeing_again(_alone("seeing", "lidar", "b"), movable=movable)
    back = ReplaceCommand("lidar", "camera", fresh=True)
    monkeypatch.setattr(clients, "some_command", lambda *_: back)
    faults = (SimulatedFault(4.0, "cut link", "a", "c", lasts=16.0),)
    scenario = structs.replace(scenario, faults=faults, moves=True, is_wild=True)
    outcome = simulate(scenario, 1)
    assert outcome.message == ""
    assert any("did not replace architecture 'lidar'" in line for line in outcome.trace)


@pytest.mark.slow
def test_the_next_leader_knows_what_may_be_at_work_yet() -> None:
    faults = (
        SimulatedFault(4.0, "isolate computer", "c", lasts=16.0),
        SimulatedFault(6.0, "kill manager", "a", lasts=0.5),
    )
    election = small_scenario(elects=True).election
    scenario = structs.replace(_seeing_again(), faults=faults, election=election)
    outcome = simulate(scenario, 1)
    assert outcome.message == ""
    assert any("may still be at work on 'c'" in line for line in outcome.trace)
