"""Time, notices and draws of the engine."""

from __future__ import annotations

import pytest

from poise.simulation._engine import Engine
from poise.simulation.scheduler import SimulationError
from tests.simulation.native.parts import LOCAL, container, joined, model, worker


def test_it_stops_where_there_is_something_to_tell() -> None:
    engine, told = Engine(1), list[float]()
    engine.stream("a", "a").send(10, lambda: told.append(engine.now))
    assert engine.run(5.0) == LOCAL
    assert told == []  # nothing of the outside runs as an event happens
    assert engine.notify()
    assert told == [LOCAL]
    assert engine.run(5.0) == 5.0
    assert not engine.notify()


def test_the_next_event_is_known() -> None:
    engine = Engine(1)
    assert engine.next() == float("inf")
    engine.stream("a", "a").send(10, lambda: None)
    assert engine.next() == LOCAL


def test_components_that_go_on_without_any_time_are_an_error() -> None:
    engine = Engine(1)
    place = container(engine)
    forth, back = (
        engine.connector(
            name=f"{source}-{target}",
            key=f"{source}-{target}",
            slot=f"{source}-{target}",
            source=(source, 0),
            target=(target, 0),
            computer="a",
            is_direct=True,
            limit=1.0,
            size=1.0,
            costs=(0.0, 0.0),
            carries=[],
            answers=[],
        )
        for source, target in (("one", "other"), ("other", "one"))
    )
    send = engine.handler(0.0, publishes=None)
    place.connect([forth, back])
    for connector in (forth, back):
        place.add_sender(connector)
    worker(
        place, "one", model(engine, [("tick", 1.0, None, send)], {"other-one": send})
    )
    worker(place, "other", model(engine, takes={"one-other": send}))
    with pytest.raises(SimulationError, match=r"at 1\.0.* without any time"):
        engine.run(2.0)


def run(seed: int, recorded: list[float] | None = None) -> tuple[float, list[float]]:
    """Return the CPU that a component takes in ten runs, and what was drawn."""
    engine = Engine(seed, recorded or [])
    place = container(engine)
    tick = ("tick", 1.0, None, engine.handler(0.01, 0.5))
    executor = worker(place, "it", model(engine, [tick]))
    engine.run(10.5)
    return executor.cpu, engine.draws()


def test_a_seed_draws_the_same_and_another_one_does_not() -> None:
    assert run(1) == run(1)
    assert run(1)[0] != run(2)[0]


def test_a_replay_begins_with_what_was_recorded_and_goes_on_by_the_seed() -> None:
    cpu, made = run(3)
    assert len(made) == 10
    assert run(3, made) == (cpu, made)
    calm = [0.0] * 4
    assert run(3, calm)[1] == calm + made[4:]
    assert run(3, calm)[0] < cpu  # the lowest draw is the least work


def test_the_mean_of_what_is_drawn_is_the_work() -> None:
    engine = Engine(1)
    tick = ("tick", 0.1, None, engine.handler(0.01, 0.5))
    executor = worker(container(engine), "it", model(engine, [tick]))
    engine.run(2000.0)
    assert executor.done == pytest.approx(20_000, abs=2)
    assert executor.cpu / executor.done == pytest.approx(0.01, rel=0.02)


def test_an_end_lets_go_of_what_was_to_be_told() -> None:
    engine, told = Engine(1), list[int]()
    place = container(engine)
    worker(place, "target", model(engine))
    joined(engine, place, place, ("source", "target"))
    engine.stream("a", "a").send(10, lambda: told.append(1))
    engine.end()
    engine.run(5.0)
    assert not engine.notify()
    assert told == []
