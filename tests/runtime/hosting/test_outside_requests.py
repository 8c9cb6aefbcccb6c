"""What people, and programs that are no part of the robot, ask of a component."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from queue import SimpleQueue
from typing import Annotated, Any, Protocol

import pytest
from msgspec import Meta

from poise import Component, Message, Provided
from poise.clock import SystemClock
from poise.runtime.execution.counters import StatsPage, new_memory
from poise.runtime.execution.exclusion import new_chain
from poise.runtime.hosting.outside_requests import OutsideRequests
from poise.runtime.hosting.runner import Runner
from poise.wire.codec import pack
from poise.wire.records.deployment_records import ComponentSpec
from poise.wire.records.request_records import PARAMETERS, PortAnswer, PortRequest

LIMIT = 20.0
Seconds = Annotated[float, Meta(ge=0)]


class Circle(Message, tag=True):
    radius: float = 0.0


class Square(Message, tag=True):
    side: float = 0.0


class Drawing(Message):
    shapes: tuple[Circle | Square, ...] = ()
    named: dict[str, Circle] | None = None
    best: Circle | None = None


class Burns(Protocol):
    def burn(self, seconds: Seconds) -> None: ...

    def draw(self, drawing: Drawing) -> None: ...


class Burner(Component):
    burns: Provided[Burns]

    def reconfigure(self, parameters: Mapping[str, Any]) -> None:
        sys.exit(f"no {list(parameters)}")

    def burn(self, seconds: Seconds) -> None:
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            pass

    def draw(self, drawing: Drawing) -> None:
        pass


class Asked:
    """A component at work, of which something is asked."""

    def __init__(self) -> None:
        spec = ComponentSpec(name="burner", goal="active", parameters={"gain": 0})
        self.key = spec.name, spec.epoch
        self.runner = Runner(spec, Burner, SystemClock(), lambda: None)
        self.runner.start()
        self.runner.aim("active")
        assert self.runner.life_cycle.wait_state({"active"}, LIMIT) == "active"
        self._answers = SimpleQueue[PortAnswer]()
        self._requests = OutsideRequests(lambda _: self.runner, self._answers.put)

    def burn(self, seconds: float) -> PortAnswer:
        return self.ask("burns", "burn", [[seconds], {}])

    def ask(self, port: str, method: str, value: object) -> PortAnswer:
        self._requests.take(self.request(port, method, value))
        return self._answers.get(timeout=LIMIT)

    def request(self, port: str, method: str, value: object) -> PortRequest:
        return PortRequest(
            number=1,
            container="here",
            component="burner",
            port=port,
            method=method,
            value=pack(value),
            limit=LIMIT,
        )

    def ask_late(self, left: float) -> PortAnswer:
        """Ask for something that others have kept waiting for all but what is left."""
        request = self.request("burns", "burn", [[0.0], {}])
        return self._requests._outcome(request, time.monotonic() + left)

    def close(self) -> None:
        self._requests.close()
        self.runner.aim("finalized")
        assert self.runner.wait_ended(LIMIT)


@pytest.fixture
def asked() -> Iterator[Asked]:
    asked = Asked()
    yield asked
    asked.close()


def test_the_cpu_time_of_a_call_from_outside_counts_for_its_component(
    asked: Asked,
) -> None:
    """It goes over no connector, so none is told of."""
    page = StatsPage(new_memory())
    page.show({asked.key: asked.runner}, ())
    before = page.cpu()[1][asked.key]
    for _ in range(2):
        assert asked.burn(0.1).outcome == "done"
    assert 0.2 <= page.cpu()[1][asked.key] - before < 0.3
    read = page._sampler.read()
    assert read is not None
    assert read[3] == []


def test_an_argument_out_of_range_is_named_with_its_plain_type(asked: Asked) -> None:
    answer = asked.burn(-1.0)
    assert answer.outcome == "refused"
    assert answer.reason.startswith("argument 1 of burn is not of type float: ")


CIRCLE = {"type": "Circle", "radius": 1.0}
WRONG = {"type": "Circle", "side": 1.0}


@pytest.mark.parametrize("name", ["shapes", "named", "best"])
def test_fields_that_a_message_inside_has_not_are_told(asked: Asked, name: str) -> None:
    def with_part(part: object) -> object:
        parts = {"shapes": [CIRCLE, part], "named": {"a": part}, "best": part}
        return [[{name: parts[name]}], {}]

    assert asked.ask("burns", "draw", with_part(CIRCLE)).outcome == "done"
    answer = asked.ask("burns", "draw", with_part(WRONG))
    assert answer.outcome == "refused"
    assert "Circle has no 'side'; it has 'radius'" in answer.reason


def test_who_had_to_wait_for_others_is_told_for_how_long(asked: Asked) -> None:
    asked.runner.exclusion.enter(new_chain(), LIMIT)
    try:
        answer = asked.ask_late(0.002)
    finally:
        asked.runner.exclusion.leave()
    assert answer.outcome == "late"
    assert answer.reason.startswith("component 'burner' was busy for ")
    assert answer.reason.endswith(" s, after 20 s behind other requests from outside")


def test_parameters_are_refused_by_whatever_a_hook_raises(asked: Asked) -> None:
    answer = asked.ask(PARAMETERS, "set", [[], {"gain": 1}])
    assert (answer.outcome, answer.error_type) == ("raised", "SystemExit")
    assert answer.reason == "no ['gain']"
