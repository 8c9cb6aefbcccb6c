"""What computers use, and other programs on them."""

from __future__ import annotations

import pytest

from poise.manage.observe.estimates import Loads
from poise.model.robot import Robot
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ContainerSample,
)


def test_another_program_is_known_0_6_s_after_it_began(robot: Robot) -> None:
    """The agent uses 10 %; from 2 s on another program takes all that is left."""
    loads = Loads(robot, emulated=True)
    for tick in range(14):
        at = 0.2 * tick
        busy = 0.1 * at + 0.9 * max(0.0, at - 2.0)
        loads.add(AgentSample("a", at, 0.1 * at, (), busy))
    found = loads.loads()["a"]
    assert found.used == pytest.approx(1.0)
    assert found.background == pytest.approx(0.9)


def test_an_agent_that_was_restarted_makes_no_load(robot: Robot) -> None:
    """It counts from 0 again, and the containers that it adopts go on."""
    loads = Loads(robot, emulated=True)
    for tick in range(14):
        at = 0.2 * tick
        container = ContainerSample("one", 7, at, 0.3 * at, 0, (), ())
        agent = 0.1 * at - (0.2 if tick > 10 else 0.0)
        loads.add(AgentSample("a", at, agent, (container,), 0.4 * at))
        for load in loads.loads().values():
            assert load.used == pytest.approx(0.4)
            assert not load.background


def test_a_container_that_ends_leaves_no_load_of_other_programs(robot: Robot) -> None:
    """It used 0.9 cores, for 0.1 s more after its last sample; others use 0.05."""
    loads = Loads(robot, emulated=True)
    for tick in range(20):
        at = 0.2 * tick
        busy = 0.05 * at + 0.9 * min(at, 2.1)
        one = ContainerSample("one", 7, at, 0.9 * at, 0, (), ())
        loads.add(AgentSample("a", at, 0.0, (one,) if at <= 2.1 else (), busy))
        for load in loads.loads().values():
            assert load.background == pytest.approx(0.05)


def test_what_each_component_uses_now_is_known(robot: Robot) -> None:
    """From 2 s on one spins; the other one is idle."""
    loads = Loads(robot, emulated=True)
    for tick in range(14):
        at = 0.2 * tick
        cpu = max(0.0, at - 2.0)
        components = (
            ComponentSample("eye", 1, cpu, 0.0, 0, 0),
            ComponentSample("mind", 1, 0.5, 0.0, 0, 0),
        )
        container = ContainerSample("one", 7, at, cpu, 0, components, ())
        loads.add(AgentSample("a", at, 0.0, (container,), cpu))
    assert loads.loads()["a"].components == {"eye": pytest.approx(1.0)}
