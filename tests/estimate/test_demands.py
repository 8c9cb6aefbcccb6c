import pytest
from msgspec.structs import replace

from poise.estimate.demands import missing, shifted_cpu_demand, with_profile
from poise.estimate.online import Estimate
from poise.estimate.profiles import Profile
from poise.model.robot import ComponentEntry, Robot


def component(robot: Robot, name: str) -> ComponentEntry:
    return next(c for c in robot.components() if c.name == name)


def test_fills_what_the_file_leaves_open(robot: Robot, profile: Profile) -> None:
    """CPU (0.12 + 0.02) * 1.05, memory (8 + 2) MB * 1.1; the state is 100 bytes."""
    eye = component(with_profile(robot, profile), "eye")
    assert eye.demand == pytest.approx({"cpu": 0.147, "memory": 11e6})
    assert eye.state == 100


def test_the_robot_file_wins(robot: Robot, profile: Profile) -> None:
    mind = component(with_profile(robot, profile), "mind")
    assert mind.demand == pytest.approx({"cpu": 0.5, "memory": 4.4e6})


def test_fills_the_traffic_of_connectors(robot: Robot, profile: Profile) -> None:
    (connector,) = with_profile(robot, profile).all_connectors()
    assert (connector.rate, connector.message) == (10.0, 1000.0)
    assert connector.cost == pytest.approx(0.12)  # see test_overhead


def test_overheads_are_traffic_where_nobody_calibrated(
    robot: Robot, profile: Profile
) -> None:
    (connector,) = with_profile(robot, replace(profile, costs={})).all_connectors()
    assert connector.overhead is None
    assert connector.cost == pytest.approx(0.01)


def declared(robot: Robot, **values: float) -> Robot:
    """Return the robot with what its file says of its connector."""
    (see,) = robot.architectures
    joined = replace(see.connectors[0], **values)
    return replace(robot, architectures=(replace(see, connectors=(joined,)),))


def test_a_declared_overhead_wins(robot: Robot, profile: Profile) -> None:
    (connector,) = with_profile(declared(robot, overhead=7.0), profile).all_connectors()
    assert connector.cost == 7.0


def test_a_declared_rate_counts_in_the_overhead(robot: Robot, profile: Profile) -> None:
    """20 messages of 1000 B a second: twice as many as were measured."""
    (connector,) = with_profile(declared(robot, rate=20.0), profile).all_connectors()
    assert connector.cost == pytest.approx(0.24)


def test_a_declared_demand_of_0_wins_and_a_rate_of_0_is_not_known(
    robot: Robot, profile: Profile
) -> None:
    (see,) = robot.architectures
    idle = tuple(replace(c, demand={"cpu": 0.0}, state=0.0) for c in see.components)
    robot = replace(robot, architectures=(replace(see, components=idle),))
    filled = with_profile(declared(robot, rate=0.0, message=0.0), profile)
    eye = component(filled, "eye")
    assert (eye.demand["cpu"], eye.state) == (0.0, 100.0)
    (connector,) = filled.all_connectors()
    assert (connector.rate, connector.message) == (10.0, 1000.0)


def test_an_overhead_of_0_makes_a_connector_count_for_nothing(
    robot: Robot, profile: Profile
) -> None:
    (connector,) = with_profile(declared(robot, overhead=0.0), profile).all_connectors()
    assert connector.cost == 0.0


def test_names_what_nobody_knows(robot: Robot, profile: Profile) -> None:
    assert missing(robot, profile) == []
    nothing = Profile(robot="r", poise="", computer="a", speed=1.0, at="", seconds=1.0)
    assert missing(robot, nothing) == ["eye", "mind"]
    assert with_profile(robot, nothing) == robot


def test_a_declared_demand_of_0_may_drift() -> None:
    """In proportion to 0 nothing ever would: (0.8 + 0.01) * 1.05 cores."""
    now = Estimate(mean=0.8, p95=0.8, error=0.01)
    assert shifted_cpu_demand(0.0, 0.2, now) == pytest.approx(0.8505)
    assert shifted_cpu_demand(0.3, 0.2, now) == pytest.approx(1.2)
