"""How components end that have, or were to have, a node."""

from __future__ import annotations

import pytest

from poise import Component
from poise.clock import SystemClock
from poise.ros2.bag_player import BagPlayer
from poise.ros2.node import RosNode
from poise.ros2.service_bridges import ServesRos
from poise.runtime.hosting.runner import Runner
from poise.wire.records.deployment_records import ComponentSpec
from tests.waiting import LIMIT


@pytest.mark.parametrize("code", [RosNode, ServesRos, BagPlayer])
def test_one_that_was_never_configured_ends_well(code: type[Component]) -> None:
    spec = ComponentSpec(name="one", goal="inactive")
    runner = Runner(spec, code, SystemClock(), lambda: None)
    runner.aim("finalized")
    runner.start()
    assert runner.wait_ended(LIMIT)
    assert (runner.life_cycle.state, runner.bad_end) == ("finalized", "")
