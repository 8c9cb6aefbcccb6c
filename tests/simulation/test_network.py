"""Links: order, loss, cuts, clogs."""

from __future__ import annotations

from collections import Counter
from functools import partial

import pytest

from poise.simulation.link_models import LinkModel
from poise.simulation.network import Network
from poise.simulation.scheduler import Scheduler


def network_of(scheduler: Scheduler, **model: float) -> Network:
    scheduler.at(1e6, lambda: None)
    return Network(scheduler, model=LinkModel(**model))


def test_a_stream_keeps_its_order_whatever_the_jitter(scheduler: Scheduler) -> None:
    network = network_of(scheduler, jitter=0.5)
    stream, arrived = network.engine.stream("a", "b"), list[int]()
    for number in range(50):
        stream.send(10, partial(arrived.append, number))
    scheduler.run(100.0)
    assert arrived == list(range(50))


def test_datagrams_may_overtake_each_other(scheduler: Scheduler) -> None:
    network = network_of(scheduler, jitter=0.5)
    moments = [at for _ in range(50) for at in network.arrivals("a", "b", 10)]
    assert len(moments) == 50
    assert moments != sorted(moments)


def test_datagrams_are_lost_and_doubled_as_often_as_the_fault_says(
    scheduler: Scheduler,
) -> None:
    network = network_of(scheduler)
    network.loss = 0.2
    copies = Counter(len(network.arrivals("a", "b", 10)) for _ in range(2000))
    # 1600 come, 80 of them twice; the standard deviations are 18 and 9
    assert 1500 < copies[1] + copies[2] < 1700
    assert 40 < copies[2] < 120


def test_what_is_sent_over_a_cut_arrives_in_order_once_it_is_healed(
    scheduler: Scheduler,
) -> None:
    network = network_of(scheduler)
    stream, arrived = network.engine.stream("a", "b"), list[tuple[int, float]]()

    def note(number: int) -> None:
        arrived.append((number, scheduler.now))

    network.cut("a", "b")
    for number in range(3):
        stream.send(10, partial(note, number))
    scheduler.at(4.0, lambda: network.heal("a", "b"))
    scheduler.run(10.0)
    assert [number for number, _ in arrived] == [0, 1, 2]
    assert 4.0 < arrived[0][1] < 4.0 + 1.5 + 0.1  # TCP sends again within 1.5 s


def test_a_cut_of_one_way_leaves_the_other(scheduler: Scheduler) -> None:
    network = network_of(scheduler)
    network.cut("a", "b")
    assert not network.arrivals("a", "b", 10)
    assert network.arrivals("b", "a", 10)


def test_a_link_that_was_cut_twice_is_cut_until_both_are_healed(
    scheduler: Scheduler,
) -> None:
    network = network_of(scheduler)
    network.cut("a", "b")
    network.cut("a", "b")
    network.heal("a", "b")
    assert network.is_cut("a", "b")
    network.heal("a", "b")
    assert not network.is_cut("a", "b")


def test_a_clog_delays_what_is_sent_meanwhile(scheduler: Scheduler) -> None:
    network = network_of(scheduler)
    network.engine.clog("a", "b", 2.0)
    assert [*network.arrivals("a", "b", 10)] == [pytest.approx(2.0, abs=0.01)]


def test_a_large_message_takes_its_size_over_the_bandwidth(
    scheduler: Scheduler,
) -> None:
    network = network_of(scheduler, bandwidth=1e6, jitter=0.0, latency=0.001)
    arrived: list[float] = []
    network.engine.stream("a", "b").send(500_000, lambda: arrived.append(scheduler.now))
    scheduler.run(5.0)
    assert arrived == [pytest.approx(0.501)]  # 1 ms and 0.5 MB at 1 MB/s
