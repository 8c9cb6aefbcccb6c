"""The last message of a port reaches late subscribers, each once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from poise import Component, Message, Published, published, subscribed
from poise.runtime.connectors.latest import Heard, LatestMessage, Number, Numbered, take
from poise.runtime.execution.data_age import Stamped
from poise.wire.records.deployment_records import ChainPart
from tests.runtime.conftest import Pair, every_kind
from tests.waiting import wait_until


class Map(Message):
    number: int
    cells: NDArray[np.uint8]


class Mapper(Component):
    map: Published[Map] = published(latest=True)


class Planner(Component):
    def __init__(self) -> None:
        self.came: list[int] = []

    @subscribed(keep=10)
    def map(self, message: Map) -> None:
        assert message.cells.sum() == message.number
        self.came.append(message.number)


def a_map(number: int) -> Map:
    return Map(number, np.ones(number, np.uint8))


def taken(*came: tuple[Number, bool, str]) -> list[Any]:
    """Return which messages a target takes of those that come."""
    heard, took = Heard(), list[Any]()
    for number, is_again, text in came:
        take(heard, "a-b", Numbered(number, is_again, text), took.append)
    return took


def test_takes_a_message_once_and_none_again_that_is_older() -> None:
    one, two = (1, 10), (1, 20)
    assert taken((one, False, "one"), (one, True, "one")) == ["one"]
    assert taken((one, True, "one"), (one, False, "one")) == ["one"]
    assert taken((two, False, "two"), (one, True, "one")) == ["two"]
    assert taken((one, False, "one"), (two, True, "two")) == ["one", "two"]


def test_takes_new_messages_whatever_their_numbers() -> None:
    """As of a publisher on a computer whose clock was set back."""
    one, two = (1, 10), (1, 20)
    assert taken((two, False, "two"), (one, False, "one")) == ["two", "one"]


def test_numbers_grow_from_incarnation_to_incarnation() -> None:
    before = LatestMessage(Map, epoch=3)
    numbers = [before.next(a_map(each)).number for each in range(100)]
    after = LatestMessage(Map, epoch=4)
    after.restore(before.to_frame())
    assert after.last is not None
    assert (after.last.number, after.last.value.number) == (numbers[-1], 99)
    numbers.append(after.next(a_map(1)).number)
    assert numbers == sorted(set(numbers))


def test_does_not_go_on_with_messages_of_another_type() -> None:
    before, after = LatestMessage(Map, 0), LatestMessage(Stamped, 1)
    before.next(a_map(1))
    after.restore(before.to_frame())
    assert after.last is None


@pytest.mark.slow
@every_kind
def test_a_late_subscriber_gets_the_last_message_once(pair: Pair) -> None:
    mapper = pair.run("source", Mapper)
    pair.activate()
    for number in (1, 2):
        mapper.map.publish(a_map(number))
    planner = pair.run("target", Planner)
    pair.join("map")
    pair.activate()
    wait_until(lambda: planner.came == [2])
    mapper.map.publish(a_map(3))
    wait_until(lambda: planner.came == [2, 3])
    assert pair.drops() == 0


@pytest.mark.slow
@every_kind
def test_what_is_sent_again_has_data_of_unknown_age(pair: Pair) -> None:
    mapper = pair.run("source", Mapper, ChainPart(name="way", is_first=True))
    pair.activate()
    mapper.map.publish(a_map(5))
    planner = pair.run("target", Planner, ChainPart(name="way", deadline=1e-9))
    pair.join("map")
    pair.let_chains_pass(carries=("way",))
    pair.activate()
    wait_until(lambda: planner.came == [5])
    (chain,) = pair.runners["target", 0].status().chains
    assert (chain.age.count, chain.missed) == (0, 0)


@pytest.mark.slow
@every_kind
def test_a_subscriber_from_the_start_gets_each_message_once(pair: Pair) -> None:
    mapper, planner = pair.run("source", Mapper), pair.run("target", Planner)
    pair.join("map")
    pair.activate()
    for number in range(1, 8):
        mapper.map.publish(a_map(number))
    wait_until(lambda: planner.came == [1, 2, 3, 4, 5, 6, 7])


@pytest.mark.slow
@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_a_subscriber_that_was_restarted_gets_the_last_message(pair: Pair) -> None:
    mapper, planner = pair.run("source", Mapper), pair.run("target", Planner)
    pair.join("map")
    pair.activate()
    mapper.map.publish(a_map(4))
    wait_until(lambda: planner.came == [4])
    planner = pair.start_targets_computer_anew(Planner)
    wait_until(lambda: planner.came == [4])
