import pytest

from poise.estimate.predict import overheads, predicted_cpu
from poise.estimate.profile import Profile
from poise.model.robot import Robot
from tests.estimate.conftest import JOINED


def test_adds_means_shares_and_agents(robot: Robot, profile: Profile) -> None:
    """Together on a: 0.1 + 0.02 + 0.3 and an agent; b has its agent only."""
    found = predicted_cpu(robot, {"eye": "a", "mind": "a"}, profile)
    assert found == pytest.approx({"a": 0.43, "b": 0.01})


def test_adds_half_of_a_connector_to_each_end(robot: Robot, profile: Profile) -> None:
    """10 messages of 1000 B a second cost 10 * 100 us + 10 kB * 10 ns = 1.1 ms/s."""
    found = predicted_cpu(robot, {"eye": "a", "mind": "b"}, profile)
    assert found == pytest.approx({"a": 0.13 + 0.00055, "b": 0.31 + 0.00055})


def test_overhead_is_what_being_apart_costs(profile: Profile) -> None:
    """In hundredths of a core; without measured costs, MB/s."""
    assert overheads(profile) == pytest.approx({str(JOINED): 0.11})
