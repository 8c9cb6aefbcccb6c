"""Mailboxes, calls, publications, leases and moves of simulated components."""

from __future__ import annotations

import pytest

from poise.simulation._engine import Container, Engine, Executor, Sender
from tests.simulation.native.parts import LOCAL, container, joined, model, worker


@pytest.fixture
def engine() -> Engine:
    return Engine(1)


def publisher(engine: Engine, place: Container, rate: float = 1.0) -> Executor:
    """Return a component that publishes every 100 ms, so much in each run."""
    handler = engine.handler(0.001, publishes=[("out", rate)])
    return worker(place, "source", model(engine, [("tick", 0.1, None, handler)]))


def pair(
    engine: Engine, work: float = 0.01, keep: int = 50, *, chain: str = ""
) -> tuple[Container, Executor, Container, Executor]:
    """Return a publisher, and one that takes its messages in another container."""
    one, other = container(engine), container(engine)
    source = publisher(engine, one)
    takes = {"out": engine.handler(work)}
    target = worker(other, "target", model(engine, takes=takes, keep=[(["out"], keep)]))
    joined(engine, one, other, ("source", "target"), chain=chain)
    return one, source, other, target


def test_each_message_is_processed_once(engine: Engine) -> None:
    _, source, _, target = pair(engine)
    engine.run(10.05)
    assert source.done == 100
    assert target.done == 100
    assert target.cpu == pytest.approx(1.0)
    assert engine.ledger.processed == 100
    assert engine.ledger.handled == 200


def test_a_run_that_goes_on_counts_meanwhile(engine: Engine) -> None:
    """As the kernel's counters do; else half a minute's mean is one sample's."""
    handler = engine.handler(1.0)
    place = container(engine, cpu=engine.cpu(1.0, speed=0.5))
    slow = worker(place, "slow", model(engine, [("tick", 5.0, None, handler)]))
    for until, used in (5.4, 0.2), (6.0, 0.5), (8.0, 1.0):
        engine.run(until)
        assert slow.cpu == pytest.approx(used)


def test_the_oldest_message_makes_room(engine: Engine) -> None:
    _, _, _, target = pair(engine, work=1.0, keep=2)
    engine.run(1.05)  # ten came: one runs, two wait, and seven made room
    assert target.asked == 10
    assert engine.ledger.dropped == 7
    engine.run(1.11)
    assert engine.ledger.violations == []


def listener(engine: Engine, *ports: tuple[list[str], int]) -> list[Sender]:
    """Let a component take a second for each of ten messages a second over each slot.

    Each port has slots, and keeps some messages. Return what counts the messages that
    were taken over each slot.
    """
    other = container(engine)
    slots = [slot for slots, _ in ports for slot in slots]
    takes = {
        slot: engine.handler(1.0, publishes=[(f"of {slot}", 1.0)]) for slot in slots
    }
    worker(other, "target", model(engine, takes=takes, keep=ports))
    ends, heard = [], container(engine)
    counts = [
        joined(engine, other, heard, ("target", "heard"), slot=f"of {slot}")[0]
        for slot in slots
    ]
    for slot in slots:
        place = container(engine)
        tick = engine.handler(0.001, publishes=[(slot, 1.0)])
        worker(place, slot, model(engine, [("tick", 0.1, None, tick)]))
        ends.append(joined(engine, place, other, (slot, "target"), slot=slot)[1])
    other.connect(ends)
    return counts


def test_a_port_keeps_as_many_whoever_publishes(engine: Engine) -> None:
    listener(engine, (["one", "two"], 2))
    engine.run(1.05)  # twenty came: one runs, two wait
    assert engine.ledger.dropped == 17
    engine.run(60.05)
    assert engine.ledger.violations == []


def test_the_newest_message_is_handled_in_the_turn_of_what_it_replaces(
    engine: Engine,
) -> None:
    of_newest, of_last = listener(engine, (["newest"], 1), (["last"], 9))
    engine.run(60.55)  # by turns: the newest, and nine of the others
    assert (of_newest.messages, of_last.messages) == (7, 53)
    assert engine.ledger.violations == []


def test_what_comes_while_it_moves_takes_no_room(engine: Engine) -> None:
    _, source, _, target = pair(engine, work=1.0, keep=1)
    target.pause()
    engine.run(0.55)
    target.resume()
    engine.run(0.65)  # this one has the room
    source.pause()
    engine.run(10.0)
    assert (target.done, engine.ledger.dropped) == (6, 0)


@pytest.mark.parametrize("is_elsewhere", [False, True])
@pytest.mark.parametrize("how", ["its process", "it", "its connection"])
def test_what_ends_with_its_target_is_dropped_but_never_by_a_move(
    engine: Engine, how: str, *, is_elsewhere: bool
) -> None:
    _, _, other, target = pair(engine, work=1.0)
    engine.run(0.55)  # five came, one of which runs
    if is_elsewhere:
        worker(container(engine), "target", model(engine), epoch=1)
    target.set_wanted(False)
    if how == "its process":
        other.end()
    elif how == "it":
        other.remove(target)
    else:
        other.connect([])
        engine.run(0.95)
    assert engine.ledger.dropped == (0 if is_elsewhere else 4)


def test_what_waits_for_an_idle_component_is_dropped_wherever_another_begins(
    engine: Engine,
) -> None:
    _, _, other, target = pair(engine, work=1.0)
    engine.run(0.55)  # five came, one of which runs
    target.set_idle(True)
    worker(container(engine), "target", model(engine), epoch=1)
    other.remove(target)
    assert engine.ledger.dropped == 4


def test_what_is_wanted_is_connected(engine: Engine) -> None:
    _, _, other, _ = pair(engine)
    engine.run(0.5)
    other.connect([])
    engine.run(1.0)
    assert engine.ledger.dropped == 0  # so that what follows is a violation


def test_fractions_of_messages_add_up_over_the_runs(engine: Engine) -> None:
    place = container(engine)
    publisher(engine, place, 0.25)
    sender, _ = joined(engine, place, container(engine), ("source", "target"))
    engine.run(10.05)
    assert sender.messages == 25


def calling(engine: Engine, limit: float) -> tuple[Executor, Container]:
    """Return a component that calls another container every second, before it works."""
    one, other = container(engine), container(engine)
    ask = engine.handler(0.01, calls=[("out", 1.0)])
    caller = worker(one, "caller", model(engine, [("tick", 1.0, None, ask)]))
    joined(engine, one, other, ("caller", "server"), limit=limit)
    return caller, other


def test_a_caller_waits_for_the_answer(engine: Engine) -> None:
    caller, other = calling(engine, 0.5)
    worker(other, "server", model(engine, serves={"out": engine.handler(0.2)}))
    engine.run(5.9)
    (status,) = caller.timers(5.9)
    assert status.duration.maximum == pytest.approx(0.2 + 2 * LOCAL + 0.01)
    assert (engine.ledger.calls, engine.ledger.failed_calls) == (5, 0)


def test_a_call_that_nobody_answers_ends_at_its_limit(engine: Engine) -> None:
    caller, _ = calling(engine, 0.5)
    engine.run(5.9)
    (status,) = caller.timers(5.9)
    assert status.duration.maximum == pytest.approx(0.5 + 0.01)
    assert (engine.ledger.calls, engine.ledger.failed_calls) == (0, 5)


def test_an_answer_after_the_limit_is_not_heard(engine: Engine) -> None:
    caller, other = calling(engine, 0.1)
    worker(other, "server", model(engine, serves={"out": engine.handler(0.3)}))
    engine.run(5.9)
    (status,) = caller.timers(5.9)
    assert status.duration.maximum == pytest.approx(0.1 + 0.01)
    assert (engine.ledger.calls, engine.ledger.failed_calls) == (0, 5)


def test_a_call_in_one_container_takes_no_time_of_its_own(engine: Engine) -> None:
    place = container(engine)
    ask = engine.handler(0.01, calls=[("out", 2.0)])
    caller = worker(place, "caller", model(engine, [("tick", 1.0, None, ask)]))
    worker(place, "server", model(engine, serves={"out": engine.handler(0.1)}))
    joined(engine, place, place, ("caller", "server"))
    engine.run(1.5)
    (status,) = caller.timers(1.5)
    assert status.duration.maximum == pytest.approx(2 * 0.1 + 0.01)
    assert engine.ledger.calls == 2


def test_a_leased_component_works_until_its_lease_ends(engine: Engine) -> None:
    place = container(engine)
    source = publisher(engine, place)
    sender, _ = joined(engine, place, container(engine), ("source", "target"))
    source.set_leased(True)
    place.set_lease_end(0.5005)  # the run that begins at 0.5 s may not publish
    engine.run(2.0)
    assert source.done == 5
    assert sender.messages == 4
    assert not source.is_working
    place.set_lease_end(9.0)
    assert source.is_working


def test_what_comes_in_a_pause_is_taken_after_it(engine: Engine) -> None:
    _, _, other, target = pair(engine)
    engine.run(0.25)
    other.pause(True)
    engine.run(1.05)
    assert (target.asked, target.done) == (2, 2)
    other.pause(False)
    assert target.asked == 10
    engine.run(1.15)
    assert engine.ledger.violations == []
    assert target.done == 11


def test_a_container_that_ended_does_nothing(engine: Engine) -> None:
    one, source, other, target = pair(engine)
    engine.run(0.55)
    other.end()
    engine.run(1.05)
    assert (source.done, target.done) == (10, 5)
    one.end()
    engine.run(2.0)
    assert source.done == 10


def test_a_sender_buffers_during_a_move_and_then_sends_in_order(engine: Engine) -> None:
    one, other, new = (container(engine) for _ in range(3))
    publisher(engine, one)
    sender, _ = joined(engine, one, other, ("source", "target"))
    before = worker(other, "target", model(engine))
    engine.run(0.55)
    sender.buffer()
    sender.mark(7)
    before.pause()
    engine.run(1.05)
    assert (before.done, before.marker("out"), before.marker("other")) == (5, 7, 0)
    after = worker(new, "target", model(engine), epoch=1)
    _, connector = joined(engine, one, new, ("source", "target"), epochs=(0, 1))
    sender.redirect(connector)
    engine.run(1.15)
    assert after.done == 6  # those of 0.6 to 1.0 s were buffered
    assert engine.ledger.processed == 11
    assert engine.ledger.violations == []


def test_what_waits_moves_and_comes_back(engine: Engine) -> None:
    _, _, other, target = pair(engine)
    target.pause()
    engine.run(0.35)
    state = target.hand_over()
    engine.run(0.55)
    target.take_back(state)
    target.resume()
    target.work()
    engine.run(0.65)
    assert target.done == 6
    assert engine.ledger.violations == []
    other.remove(target)
    engine.run(1.0)
    assert target.done == 6


def test_a_message_of_a_lost_source_is_refused_once_the_next_one_has_sent(
    engine: Engine,
) -> None:
    lost, next_one, other = (container(engine) for _ in range(3))
    target = worker(other, "target", model(engine))
    handler = engine.handler(0.001, publishes=[("out", 1.0)])
    publishing = model(engine, [("tick", 0.1, None, handler)])
    _, first = joined(engine, lost, other, ("source", "target"))
    _, second = joined(engine, next_one, other, ("source", "target"), epochs=(1, 0))
    other.connect([first, second])
    worker(next_one, "source", publishing, epoch=1)
    engine.run(0.15)
    assert target.done == 1
    lost_source = worker(lost, "source", publishing, epoch=0)
    engine.run(0.29)
    assert lost_source.done == 1
    assert target.done == 2  # of the next one; it works at 0.1, 0.2 s
    other.connect([first])  # the next one is not joined any more
    engine.run(0.36)
    assert target.done == 3


def test_two_that_work_at_one_time_are_a_violation(engine: Engine) -> None:
    one, other = container(engine, "a"), container(engine, "b")
    publisher(engine, one)
    engine.run(0.15)
    worker(
        other,
        "source",
        model(engine, [("tick", 0.1, None, engine.handler(0.001))]),
        epoch=1,
    )
    engine.run(0.35)
    assert engine.ledger.violations[0] == (
        "nothing-active-twice",
        (
            "'source' (0) on 'a' published at 0.201 s, but 'source' (1) on 'b' "
            "has worked since 0.200 s"
        ),
    )


def test_an_earlier_one_that_works_after_a_committed_move_is_a_violation(
    engine: Engine,
) -> None:
    publisher(engine, container(engine))
    engine.ledger.commit("source", 3)
    engine.run(0.15)
    assert engine.ledger.violations == [
        (
            "committed-stays",
            (
                "'source' (0) on 'a' began a handler at 0.100 s, but a move to "
                "incarnation 3 was committed"
            ),
        )
    ]


def test_a_message_that_is_processed_twice_is_a_violation(engine: Engine) -> None:
    _, _, _, target = pair(engine)
    target.pause()
    engine.run(0.15)
    state = target.hand_over()
    for _ in range(2):
        target.take_back(state)
    target.resume()
    target.work()
    engine.run(0.19)
    assert engine.ledger.violations == [
        (
            "each-message-once-in-order",
            "'target' (0) on 'a' processed message 1 of 'out' after 1",
        )
    ]


def test_what_waits_for_a_component_may_be_older_than_what_its_alternative_took(
    engine: Engine,
) -> None:
    one, other, new = (container(engine) for _ in range(3))
    publisher(engine, one)
    sender, _ = joined(engine, one, other, ("source", "target"))
    frozen = worker(other, "target", model(engine))
    frozen.pause()
    engine.run(0.35)
    alternative = worker(new, "alternative", model(engine), epoch=1)
    _, connector = joined(engine, one, new, ("source", "alternative"), epochs=(0, 1))
    sender.redirect(connector)
    engine.run(0.55)
    frozen.resume()
    frozen.work()
    engine.run(0.59)
    assert (frozen.done, alternative.done) == (3, 2)
    assert engine.ledger.violations == []


def test_the_end_of_a_turn_and_missed_deadlines_are_told_when_asked_for(
    engine: Engine,
) -> None:
    told = list[str]()
    place = engine.container(
        engine.cpu(1.0),
        "a",
        lambda: told.append("progress"),
        lambda: told.append("missed"),
    )
    tick = ("tick", 0.1, 0.005, engine.handler(0.01))
    executor = worker(place, "it", model(engine, [tick]))
    place.await_progress()
    engine.run(0.105)
    executor.when_idle(lambda: told.append("idle"))
    assert executor.is_busy
    assert engine.run(5.0) == pytest.approx(0.11)
    engine.notify()
    assert told == ["progress", "missed", "idle"]
    assert engine.run(0.3) == 0.3  # nobody asked again
    place.await_missed()
    engine.run(5.0)
    engine.notify()
    assert told[3:] == ["missed"]
