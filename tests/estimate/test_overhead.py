import pytest
from msgspec.structs import replace

from poise.estimate.demands import kinds_together, overhead_of, overheads
from poise.estimate.profiles import ConnectorProfile, Costs, KindCosts, Profile
from poise.model.robot import ComponentEntry, Connector, ConnectorEnd, Robot
from tests.estimate.conftest import JOINED

CALLS = ConnectorProfile(calls=20.0, size=500.0)


def test_is_the_cpu_that_being_apart_costs_in_hundredths_of_a_core(
    profile: Profile,
) -> None:
    """20 calls of 500 B a second: 20 * 400 us + 10 kB * 20 ns = 8.2 ms/s remotely.

    A local one: 10 kB * 1 ns = 0.01 ms/s. 8.19 ms/s are 0.819 hundredths of a core.
    """
    assert overhead_of(CALLS, "local", profile.costs) == pytest.approx(0.819)


def test_is_less_where_together_is_between_containers(profile: Profile) -> None:
    """Messages: remote 1.4 ms/s, direct 0.2, local 0.5 + 0.01."""
    known = profile.connectors[str(JOINED)]
    assert overhead_of(known, "direct", profile.costs) == pytest.approx(0.12)
    assert overhead_of(known, "local", profile.costs) == pytest.approx(0.089)


def test_is_the_traffic_where_nobody_calibrated() -> None:
    """20 calls of 500 B a second are 0.01 MB/s."""
    assert overhead_of(CALLS, "direct", {}) == pytest.approx(0.01)


def test_is_never_below_zero() -> None:
    odd = {"direct": KindCosts(source=Costs(call=1.0)), "remote": KindCosts()}
    assert overhead_of(CALLS, "direct", odd) == 0


def test_components_of_one_architecture_share_a_container(robot: Robot) -> None:
    assert kinds_together(robot) == {str(JOINED): "direct"}


@pytest.mark.parametrize(
    "alone",
    [
        ComponentEntry(name="mind", isolated=True),
        ComponentEntry(name="mind", command=("cat",)),
    ],
)
def test_what_has_a_container_of_its_own_is_local(
    robot: Robot, alone: ComponentEntry
) -> None:
    (see,) = robot.architectures
    apart_ = replace(see, components=(see.components[0], alone))
    found = kinds_together(replace(robot, architectures=(apart_,)))
    assert found == {str(JOINED): "local"}


def test_architectures_do_not_share_a_container(robot: Robot) -> None:
    between = Connector(
        between=(ConnectorEnd("mind", "wish"), ConnectorEnd("hand", "wish"))
    )
    assert kinds_together(replace(robot, connectors=(between,)))[str(between)] == (
        "local"
    )


def test_overheads_of_all_connectors_that_were_measured(
    robot: Robot, profile: Profile
) -> None:
    gone = {**profile.connectors, "x -> y": profile.connectors[str(JOINED)]}
    found = overheads(robot, replace(profile, connectors=gone))
    assert found == pytest.approx({str(JOINED): 0.12})
