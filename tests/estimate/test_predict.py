import pytest
from msgspec.structs import replace

from poise.estimate.predict import overheads, predicted_cpu
from poise.estimate.profile import Profile
from poise.model.robot import Robot
from tests.estimate.conftest import JOINED


def test_adds_means_shares_and_agents(robot: Robot, profile: Profile) -> None:
    """Together on a: 0.1 + 0.02 + 0.3 and an agent; b has its agent only."""
    found = predicted_cpu(robot, {"eye": "a", "mind": "a"}, profile)
    assert found == pytest.approx({"a": 0.43, "b": 0.01})


def test_adds_what_being_apart_costs_to_each_end(
    robot: Robot, profile: Profile
) -> None:
    """10 messages of 1000 B a second, beyond the 0.2 ms/s that a direct one takes.

    Remote: source 10 * 90 us + 10 kB * 10 ns = 1.0 ms/s, target 0.3 + 0.1 = 0.4 ms/s;
    of the surplus of 1.2 ms/s the source has 10 parts of 14.
    """
    found = predicted_cpu(robot, {"eye": "a", "mind": "b"}, profile)
    assert found == pytest.approx(
        {"a": 0.13 + 0.0012 * 10 / 14, "b": 0.31 + 0.0012 * 4 / 14}
    )


def test_without_measured_costs_being_apart_costs_nothing(
    robot: Robot, profile: Profile
) -> None:
    found = predicted_cpu(robot, {"eye": "a", "mind": "b"}, replace(profile, costs={}))
    assert found == pytest.approx({"a": 0.13, "b": 0.31})


def test_overheads_of_all_connectors_that_were_measured(
    robot: Robot, profile: Profile
) -> None:
    gone = {**profile.connectors, "x -> y": profile.connectors[str(JOINED)]}
    found = overheads(robot, replace(profile, connectors=gone))
    assert found == pytest.approx({str(JOINED): 0.12})
