"""Ages of data in the engine, worked out by hand.

`tests/runtime/execution/test_data_age.py` has the rule for real components.
"""

from __future__ import annotations

import pytest

from poise.simulation._engine import Engine
from tests.simulation.native.parts import LOCAL, container, joined, model, worker

LINK = 0.01


def test_the_age_is_from_the_source_s_publishing_to_the_end_of_the_last_run() -> None:
    engine = Engine(1)
    engine.set_usual_link(LINK, 0.0, 1e9)
    source, target = container(engine, "a"), container(engine, "b")
    tick = ("tick", 1.0, None, engine.handler(0.1, publishes=None))
    worker(source, "source", model(engine, [tick]), [("chain", True, None)])
    last = model(engine, takes={"out": engine.handler(0.2)})
    end = worker(target, "target", last, [("chain", False, 0.205)])
    joined(engine, source, target, ("source", "target"), chain="chain")
    engine.run(10.9)
    (status,) = end.chains()
    assert status.name == "chain"
    # 10 ms on the link and 0.2 s of work, over a deadline of 0.205 s
    assert status.age.count == 10
    assert status.age.maximum == pytest.approx(LINK + 100 / 1e9 + 0.2)
    assert status.missed == 10


def test_a_timer_works_on_what_came_last() -> None:
    engine = Engine(1)
    place, other = container(engine), container(engine)
    publish = engine.handler(0.1, publishes=None)
    worker(place, "source", model(engine, [("tick", 1.0, None, publish)]), FIRST)
    sampled = model(
        engine,
        [("look", 0.5, None, engine.handler(0.05))],
        {"out": engine.handler(0.0)},
    )
    end = worker(other, "target", sampled, [("chain", False, 10.0)])
    joined(engine, place, other, ("source", "target"), chain="chain")
    engine.run(2.4)
    (status,) = end.chains()
    # the data of 1.1 s is used as it comes, and by runs that end at 1.55 and 2.05 s;
    # that of 2.1 s as it comes
    assert status.age.count == 4
    assert status.age.maximum == pytest.approx(2.05 - 1.1)
    assert status.age.mean == pytest.approx((2 * LOCAL + 0.45 + 0.95) / 4)


def test_the_stamp_of_an_answer_is_taken() -> None:
    engine = Engine(1)
    caller, server = container(engine), container(engine)
    ask = engine.handler(0.1, calls=[("out", 1.0)])
    serve = model(engine, serves={"out": engine.handler(0.2)})
    asked = model(engine, [("tick", 1.0, None, ask)])
    end = worker(caller, "caller", asked, [("chain", False, 10.0)])
    worker(server, "server", serve, FIRST)
    joined(engine, caller, server, ("caller", "server"), chain="chain")
    engine.run(1.5)
    (status,) = end.chains()
    # it was made as the server answered; after 40 us the caller works for 0.1 s
    assert status.age.count == 1
    assert status.age.maximum == pytest.approx(LOCAL + 0.1)


def test_a_successor_goes_on_with_what_was_held() -> None:
    engine = Engine(1)
    place, other = container(engine), container(engine)
    publish = engine.handler(0.0, publishes=None)
    worker(place, "source", model(engine, [("tick", 1.0, None, publish)]), FIRST)
    taking = model(engine, [("look", 10.0, None, engine.handler(0.0))])
    last = [("chain", False, 10.0)]
    before = worker(other, "target", taking, last)
    joined(engine, place, other, ("source", "target"), chain="chain")
    engine.run(1.5)
    after = other.add(("target", 1), 2, taking, last)
    after.restore(before.hand_over())
    before.deactivate()
    after.set_wanted(True)
    after.activate()
    engine.run(10.0)
    (status,) = after.chains()
    assert status.age.maximum == pytest.approx(9.0)  # of 1 s, used at 10 s


FIRST = [("chain", True, None)]
