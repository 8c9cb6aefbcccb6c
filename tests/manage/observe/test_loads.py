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
