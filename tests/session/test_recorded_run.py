"""What a recording says of a robot, second by second."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.model.robot import Robot
from poise.session.recorded_run import RecordedRun
from poise.simulation.workload import workload_of
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ContainerSample,
)
from tests.recordings import write_recording
from tests.simulation.conftest import small_scenario
from tests.simulation.test_rehearsal import profile_of


def sample(at: float, cpu: float, epoch: int = 0) -> AgentSample:
    component = ComponentSample("arm", epoch, cpu, 0.0, 0, 0)
    container = ContainerSample("act", 5 + epoch, at, cpu, 0, (component,), ())
    return AgentSample("c", at, 0.0, (container,))


@pytest.fixture
def robot() -> Robot:
    return small_scenario().robot


@pytest.fixture
def recorded(tmp_path: Path) -> RecordedRun:
    """Return one in which `arm` takes 0.1, 0.3 and then 0.2 cores, restarted once."""
    path = tmp_path / "run.rec"
    cpu = [(100.0, 7.0), (100.5, 7.05), (100.9, 7.1), (101.5, 7.2), (101.9, 7.4)]
    again = [(102.1, 0.0), (102.9, 0.2), (103.1, 0.25)]
    samples = [
        *(sample(at, used) for at, used in cpu),
        *(sample(at, used, 1) for at, used in again),
    ]
    write_recording(path, "small", samples)
    return RecordedRun(path)


def test_cores_of_each_second(recorded: RecordedRun, robot: Robot) -> None:
    assert recorded.cores(robot) == {"arm": pytest.approx((0.1, 0.3, 0.2))}


def test_it_is_of_one_robot(recorded: RecordedRun, robot: Robot) -> None:
    with pytest.raises(UsageError, match="recorded of robot 'small', not of 'other'"):
        recorded.cores(replace(robot, name="other"))


def test_a_recording_without_samples_is_no_run_that_used_nothing(
    robot: Robot, tmp_path: Path
) -> None:
    path = tmp_path / "foxglove.mcap"
    write_recording(path, "small", [])
    recorded, table = RecordedRun(path), tmp_path / "table.csv"
    for ask in (
        lambda: recorded.cores(robot),
        lambda: recorded.replay(robot),
        lambda: recorded.export(table),
    ):
        with pytest.raises(UsageError, match=f"is recorded in {path}: `poise run"):
            ask()
    assert not table.exists()


def test_handlers_are_as_dear_in_each_second_as_they_were_then(
    recorded: RecordedRun, robot: Robot
) -> None:
    work = workload_of(robot, profile_of(robot, arm=0.2), recorded.cores(robot))
    assert work.models["arm"].factors == pytest.approx((0.5, 1.5, 1.0))
    assert work.models["mind"].factors == ()
