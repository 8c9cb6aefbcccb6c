"""A component on the bench, as a user would test it."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from poise import (
    Component,
    Message,
    Published,
    Required,
    every,
    found,
    lost,
    subscribed,
)
from poise.errors import UsageError
from poise.testing import Bench, VirtualClock


class Level(Message):
    litres: float


class Tank:
    def level(self) -> float:
        raise NotImplementedError


class Pump(Component):
    tank: Required[Tank]
    report: Published[Level]

    def configure(self) -> None:
        self.wish = float(self.parameters["wish"])

    @subscribed(keep=1)
    def order(self, message: Level) -> None:
        self.wish = message.litres

    @every(0.1)
    def look(self) -> None:
        self.measure("missing", self.wish - self.tank.level())

    @every(0.3)
    def tell(self) -> None:
        self.report.publish(Level(self.tank.level()))


class HalfFull(Tank):
    def level(self) -> float:
        return 5.0


def pump() -> Bench[Pump]:
    return Bench(Pump, {"wish": 8}, tank=HalfFull())


def test_timers_run_at_their_times() -> None:
    bench = pump()
    bench.advance(0.3)
    assert bench.measured["missing"] == [3.0, 3.0, 3.0]
    assert bench.published["report"] == [Level(5.0)]
    assert bench.clock.now() == pytest.approx(0.3)


def test_many_small_steps_are_one_large_one() -> None:
    bench = pump()
    for _ in range(30):
        bench.advance(0.1)
    assert len(bench.measured["missing"]) == 30
    assert len(bench.published["report"]) == 10


def test_messages_reach_their_port() -> None:
    bench = pump()
    bench.send("order", Level(6.0))
    bench.advance(0.1)
    assert bench.measured["missing"] == [1.0]


def test_a_port_that_is_not_there_is_named_with_those_that_are() -> None:
    with pytest.raises(UsageError, match="Pump subscribes no 'orders', but order"):
        pump().send("orders", Level(1.0))
    with pytest.raises(UsageError, match="Pump requires no 'tnak', but tank"):
        Bench(Pump, {"wish": 8}, tnak=HalfFull())


def test_a_required_port_must_be_given() -> None:
    with pytest.raises(UsageError, match=r"Pump requires tank: .*tank=\.\.\."):
        Bench(Pump, {"wish": 8})


class Asker(Component):
    tank: Required[Tank]

    @every(0.1)
    def ask(self) -> None:
        self.start_call(self.tank.level).then(lambda _: 1 / 0)

    @every(1.0)
    def look(self) -> None:
        self.age("ordre")


def test_what_takes_an_answer_raises_comes_out() -> None:
    with pytest.raises(ZeroDivisionError):
        Bench(Asker, tank=HalfFull()).advance(0.1)


def test_the_age_of_a_port_that_is_not_there_is_refused() -> None:
    bench = Bench(Asker, tank=HalfFull())
    with pytest.raises(UsageError, match="Asker subscribes no 'ordre', but nothing"):
        bench.component.look()


def test_what_the_code_raises_comes_out() -> None:
    class Dry(Tank):
        def level(self) -> float:
            raise RuntimeError("dry")

    bench = Bench(Pump, {"wish": 8}, tank=Dry())
    with pytest.raises(RuntimeError, match="dry"):
        bench.advance(0.1)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda pump: pump.measure(3, 1.0), "the name of a measure is a text, not 3"),
        (lambda pump: pump.measure("x", "y"), "measure 'x': 'y' is not a number"),
        (lambda pump: pump.measure("x", None), "measure 'x': None is not a number"),
        (lambda pump: pump.tasks.start(3), "the name of a task is a text, not 3"),
        (lambda pump: pump.tasks.cancel(None), "of a task is a text, not None"),
    ],
)
def test_what_an_agent_could_not_read_is_refused_where_it_is_said(
    wrong: Callable[[Pump], None], said: str
) -> None:
    with pump() as bench, pytest.raises(UsageError, match=said):
        wrong(bench.component)


def test_any_number_is_measured() -> None:
    numbers = (1, 2.5, True, np.float32(0.5), np.array(3), Fraction(1, 2))
    with pump() as bench:
        for number in numbers:
            bench.component.measure("any", number)  # type: ignore[arg-type]
    assert bench.measured["any"] == list(numbers)


def test_it_ends_with_the_hooks() -> None:
    called: list[str] = []

    class Ending(Component):
        def deactivate(self) -> None:
            called.append("deactivate")

        def cleanup(self) -> None:
            called.append("cleanup")

    with Bench(Ending):
        assert called == []
    assert called == ["deactivate", "cleanup"]


def test_the_clock_goes_on_only_when_told() -> None:
    clock = VirtualClock(7.0)
    assert clock.now() == 7.0
    clock.sleep(0.5)
    assert clock.now() == 7.5


class Brakes(Component):
    speed: Published[Level]

    @subscribed("scan", keep=1)
    def on_scan(self, message: Level) -> None:
        self.speed.publish(message)

    @lost("scan")
    def brake(self) -> None:
        self.measure("age", self.age("scan"))
        self.speed.publish(Level(0.0))

    @found("scan")
    def release(self) -> None:
        self.speed.publish(Level(1.0))


def test_loses_and_finds_who_publishes() -> None:
    with Bench(Brakes) as bench:
        bench.send("scan", Level(3.0))
        bench.advance(0.5)
        bench.lose("scan")
        bench.find("scan")
        with pytest.raises(UsageError, match="subscribes no 'speed', but scan"):
            bench.lose("speed")
    assert [each.litres for each in bench.published["speed"]] == [3.0, 0.0, 1.0]
    assert bench.measured["age"] == [0.5]
