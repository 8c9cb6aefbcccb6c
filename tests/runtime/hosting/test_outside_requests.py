"""What people, and programs that are no part of the robot, ask of a component."""

from __future__ import annotations

import time
from queue import SimpleQueue
from typing import Protocol

from poise import Component, Provided
from poise.clock import SystemClock
from poise.runtime.execution.counters import StatsPage, new_memory
from poise.runtime.hosting.outside_requests import OutsideRequests
from poise.runtime.hosting.runner import Runner
from poise.wire.codec import pack
from poise.wire.records.deployment_records import ComponentSpec
from poise.wire.records.request_records import PortAnswer, PortRequest

LIMIT = 20.0


class Burns(Protocol):
    def burn(self, seconds: float) -> None: ...


class Burner(Component):
    burns: Provided[Burns]

    def burn(self, seconds: float) -> None:
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            pass


def test_the_cpu_time_of_a_call_from_outside_counts_for_its_component() -> None:
    """It goes over no connector, so none is told of."""
    spec = ComponentSpec(name="burner", goal="active")
    runner = Runner(spec, Burner, SystemClock(), lambda: None)
    runner.start()
    runner.aim("active")
    assert runner.life_cycle.wait_state({"active"}, LIMIT) == "active"
    answers = SimpleQueue[PortAnswer]()
    requests, page = OutsideRequests(lambda _: runner, answers.put), new_memory()
    counters = StatsPage(page)
    key = spec.name, spec.epoch
    counters.show({key: runner}, ())
    before = counters.cpu()[key]
    for number in range(2):
        requests.take(
            PortRequest(
                number=number,
                container="here",
                component="burner",
                port="burns",
                method="burn",
                value=pack([[0.1], {}]),
                limit=LIMIT,
            )
        )
        assert answers.get(timeout=LIMIT).outcome == "done"
    assert 0.2 <= counters.cpu()[key] - before < 0.3
    read = counters._sampler.read()
    assert read is not None
    assert read[3] == []
    requests.close()
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
