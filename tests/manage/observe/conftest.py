from collections.abc import Callable, Mapping

import pytest

from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.estimates import Estimates
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentSample,
    AgentStatus,
    ComponentSample,
    ConnectorSample,
    ContainerSample,
)

Sampler = Callable[[float], AgentSample]


def status_of(
    estimates: Estimates, computers: Mapping[str, AgentStatus]
) -> RobotStatus:
    """Return the status of a robot that is estimated so, by its agents."""
    return RobotStatus(
        robot="r",
        task="work",
        manager=ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0),
        placement={},
        computers=computers,
        demand_estimates=tuple(estimates.demand_estimates()),
        traffic=estimates.traffic(),
    )


@pytest.fixture
def robot() -> Robot:
    """One computer, of half the reference's speed, with an eye and a mind on it."""
    parts = (ComponentEntry(name="eye"), ComponentEntry(name="mind"))
    return Robot(
        name="r",
        computers=(
            Computer(name="a", capacity={"cpu": 1.0, "memory": 1e9}, speed=0.5),
        ),
        architectures=(Architecture(name="see", function="seeing", components=parts),),
    )


@pytest.fixture
def steady() -> Sampler:
    """Count at a moment [s]: eye 10 %, mind 20 %, their container 32 %.

    The eye publishes 10 messages a second of 500 bytes to the mind.
    """

    def sample(at: float) -> AgentSample:
        jobs = round(10 * at)
        components = (
            ComponentSample("eye", 0, 0.1 * at, 0.0, jobs, jobs),
            ComponentSample("mind", 0, 0.2 * at, 0.0, jobs, jobs),
        )
        connector = ConnectorSample(
            "eye.x-mind.x",
            0,
            jobs,
            0,
            500 * jobs,
            0,
            0,
            jobs,
            0.002 * jobs,
            1e-4 * jobs,
        )
        container = ContainerSample(
            "see", 7, at, 0.32 * at, 9_000_000, components, (connector,)
        )
        return AgentSample("a", at, 0.01 * at, (container,))

    return sample
