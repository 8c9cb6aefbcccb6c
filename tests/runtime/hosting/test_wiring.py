"""The same component code over every kind of connector: it cannot tell them apart."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

from poise import Component, Message, Provided, Published, Required, oneway, subscribed
from poise.clock import Elapsed
from poise.errors import CalleeError, CannotCross, Timeout, Unavailable, UsageError
from poise.runtime.connectors.interface import methods
from poise.runtime.execution.exclusion import new_chain
from poise.wire.address import Address
from poise.wire.connections.channel import Channel
from poise.wire.frame import FAILURE, Frame, FrameKind, segments
from poise.wire.records.status_records import ConnectorStatus
from tests.runtime.conftest import Pair, every_kind
from tests.waiting import LIMIT, wait_until

pytestmark = pytest.mark.slow


class Scan(Message):
    number: int
    ranges: NDArray[np.float32]


class Sums(Protocol):
    def add(self, one: int, two: int = 10) -> int: ...

    def mean(self, scan: Scan) -> float: ...

    def echo(self, scan: Scan) -> Scan: ...

    def fail(self, why: str) -> None: ...

    def wait(self) -> None: ...

    def interrupt(self) -> None: ...

    @oneway
    def note(self, text: str) -> None: ...


class Target(Component):
    sums: Provided[Sums]

    def configure(self) -> None:
        self.heard: list[Any] = []
        self.came = threading.Condition()
        self.go_on = threading.Event()

    def add(self, one: int, two: int = 10) -> int:
        return one + two

    def mean(self, scan: Scan) -> float:
        return float(scan.ranges.mean())

    def echo(self, scan: Scan) -> Scan:
        return scan

    def fail(self, why: str) -> None:
        raise LookupError(why)

    def wait(self) -> None:
        self.go_on.wait(LIMIT)

    def interrupt(self) -> None:
        raise KeyboardInterrupt

    def note(self, text: str) -> None:
        self._hear(text)

    @subscribed(block=4)
    def scan(self, message: Scan) -> None:
        self._hear(message)

    @subscribed(block=3)
    def careful(self, message: Scan) -> None:
        threading.Event().wait(0.002)
        self._hear(message)

    @subscribed(keep=1)
    def latest(self, message: Scan) -> None:
        self._hear(message)

    def _hear(self, what: object) -> None:
        with self.came:
            self.heard.append(what)
            self.came.notify_all()

    def wait_for(self, count: int) -> list[Any]:
        with self.came:
            assert self.came.wait_for(lambda: len(self.heard) >= count, LIMIT)
            return self.heard


class Source(Component):
    sums: Required[Sums]
    scan: Published[Scan]
    latest: Published[Scan]
    careful: Published[Scan]


def start(pair: Pair, *ports: str, limit: float = LIMIT) -> tuple[Source, Target]:
    target, source = pair.run("target", Target), pair.run("source", Source)
    for port in ports:
        pair.join(port, limit=limit)
    pair.activate()
    return source, target


def scan(number: int = 1) -> Scan:
    return Scan(number, np.arange(4, dtype=np.float32))


@every_kind
def test_no_topic_waits_for_another_ones_grants(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    # whoever takes another link's place waits for that so long
    monkeypatch.setattr("poise.wire.connections.connection_server._PATIENCE", 3 * LIMIT)
    source, target = start(pair, "scan", "careful")
    for number in range(3):
        source.scan.publish(scan(number))
        source.careful.publish(scan(number))
    target.wait_for(6)
    assert pair.drops() == 0


@every_kind
def test_calls_bring_back_results(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    assert source.sums.add(1, 2) == 3
    assert source.sums.add(1) == 11
    assert source.sums.add(two=5, one=1) == 6


@every_kind
def test_arrays_go_there_and_back(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    assert source.sums.mean(scan()) == 1.5
    back = source.sums.echo(scan(7))
    assert back.number == 7
    np.testing.assert_array_equal(back.ranges, scan().ranges)


@every_kind
def test_what_the_callee_raises_comes_back_with_its_traceback(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises(CalleeError, match="LookupError: no such") as caught:
        source.sums.fail("no such")
    assert caught.value.type_name == "LookupError"
    assert caught.value.message == "no such"
    assert "raise LookupError(why)" in caught.value.traceback


@every_kind
def test_a_call_that_cannot_be_made_is_an_error_of_one_kind(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises(CalleeError, match=r"TypeError: .*add\(\)") as caught:
        source.sums.add(1, 2, 3)  # type: ignore[call-arg]
    assert caught.value.type_name == "TypeError"
    assert status(pair, "source").errors == 1


@every_kind
def test_a_callee_that_interrupts_itself_ends_no_connection(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises((CalleeError, KeyboardInterrupt)):
        source.sums.interrupt()
    assert source.sums.add(1, 2) == 3
    assert status(pair, "target").errors == 1


@every_kind
def test_a_call_to_a_busy_component_times_out(pair: Pair) -> None:
    source, target = start(pair, "sums", limit=0.1)
    target_runner = pair.runners["target", 0]
    target_runner.exclusion.pause(LIMIT)  # as when another chain is inside
    with pytest.raises(
        Timeout, match="busy for" if pair.kind == "direct" else "add over"
    ):
        source.sums.add(1, 2)
    target_runner.exclusion.resume()
    wait_until(lambda: _answers(source))
    target.go_on.set()


@every_kind
def test_what_has_failed_holds_up_nobody_and_keeps_nothing(pair: Pair) -> None:
    class Failing(Target):
        def activate(self) -> None:
            raise LookupError("no camera")

    pair.run("target", Failing)
    source = pair.run("source", Source)
    for port in ("sums", "scan", "latest"):
        pair.join(port)
    with pytest.raises(AssertionError, match="failed"):
        pair.activate()
    pair.runners["source", 0].aim("active")
    began = time.monotonic()
    for number in range(20):
        source.scan.publish(scan(number))
        source.latest.publish(scan(number))
        source.sums.note("anyone?")
    with pytest.raises(Unavailable, match="component 'target' has failed"):
        source.sums.add(1, 2)
    assert time.monotonic() - began < LIMIT
    wait_until(lambda: pair.drops() == 60)
    assert list(pair.runners["target", 0].endpoints.mailbox.waiting()) == []


@every_kind
def test_without_a_connector_calls_are_unavailable(pair: Pair) -> None:
    source, _ = start(pair)
    with pytest.raises(Unavailable, match=r"source\.sums"):
        source.sums.add(1, 2)


@every_kind
def test_when_the_connector_is_gone_calls_are_unavailable(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    pair.sides["source"].close()
    with pytest.raises(Unavailable):
        source.sums.add(1, 2)


@every_kind
def test_one_way_calls_keep_their_order(pair: Pair) -> None:
    source, target = start(pair, "sums")
    sent = [f"note {n}" for n in range(50)]
    for text in sent:
        source.sums.note(text)
    assert target.wait_for(50) == sent


@every_kind
def test_messages_keep_their_order_and_block_when_asked(pair: Pair) -> None:
    source, target = start(pair, "scan")
    for number in range(50):  # the queue holds four
        source.scan.publish(scan(number))
    assert [m.number for m in target.wait_for(50)] == list(range(50))
    np.testing.assert_array_equal(target.heard[9].ranges, scan().ranges)


@every_kind
def test_what_is_no_message_of_the_port_is_refused_near_and_far(pair: Pair) -> None:
    source, target = start(pair, "scan")
    with pytest.raises(UsageError, match=r"was given \[1, 2\] of type list"):
        source.scan.publish([1, 2])  # type: ignore[arg-type]
    source.scan.publish(scan())
    assert len(target.wait_for(1)) == 1


@every_kind
def test_what_a_closed_connector_counted_last_is_still_told(pair: Pair) -> None:
    """Else the counts of a run that ends with its task lack what came last."""
    source, target = start(pair, "scan")
    source.scan.publish(scan())
    assert len(target.wait_for(1)) == 1
    pair.part()
    for side in pair.sides.values():
        (last,) = side.status()
        assert (last.messages, last.ready) == (1, True)


@every_kind
def test_code_whose_port_became_another_is_named_with_its_ports(pair: Pair) -> None:
    """A replacement has what it has: the robot's check saw other code."""
    pair.run("source", Source)
    pair.run("target", Source)
    spec = pair.join("scan")
    troubles = pair.sides["target"].apply((spec,), pair.runners)
    assert "component 'target' has no port 'scan' that " in troubles["target", 0]
    assert "scan (publishes)" in troubles["target", 0]
    assert "Traceback" not in troubles["target", 0]


@every_kind
def test_a_method_that_is_not_there_is_told_with_those_that_are(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    says = (
        r"source.sums \(Sums\) has no method 'ad' \(did you mean 'add'\?\); methods: "
    )
    with pytest.raises(AttributeError, match=says):
        source.sums.ad(1, 2)  # type: ignore[attr-defined]


@every_kind
def test_publishing_to_nobody_is_no_error(pair: Pair) -> None:
    source, _ = start(pair)
    source.scan.publish(scan())


@every_kind
def test_a_message_that_finds_no_room_is_dropped_and_counted(pair: Pair) -> None:
    source, target = start(pair, "scan", limit=0.1)
    source.scan.publish(scan(0))
    target.wait_for(1)
    pair.runners["target", 0].exclusion.pause(LIMIT)
    for number in range(1, 7):  # room is for four; fewer go if it hears of that late
        source.scan.publish(scan(number))
    drops = status(pair, "source").drops
    assert drops >= 2
    pair.runners["target", 0].exclusion.resume()
    heard = [m.number for m in target.wait_for(7 - drops)]
    assert len(heard) == 7 - drops
    assert heard == sorted(set(heard))


@every_kind
def test_a_subscriber_that_gets_ready_holds_up_nobody_and_loses_nothing(
    pair: Pair,
) -> None:
    go_on = threading.Event()

    class Slow(Target):
        def activate(self) -> None:
            go_on.wait(LIMIT)

    target, source = pair.run("target", Slow), pair.run("source", Source)
    pair.join("scan")
    with ThreadPoolExecutor(1) as pool:
        active = pool.submit(pair.activate)
        runner = pair.runners["source", 0]
        wait_until(
            lambda: [end.ready for end in pair.sides["source"].status()] == [True]
        )
        runner.aim("active")
        began = time.monotonic()
        for number in range(20):
            source.scan.publish(scan(number))
        assert time.monotonic() - began < LIMIT / 2
        go_on.set()
        active.result()
    assert [message.number for message in target.wait_for(20)] == [*range(20)]
    assert pair.drops() == 0


@every_kind
def test_a_subscriber_that_was_deactivated_holds_up_nobody_and_keeps_the_last(
    pair: Pair,
) -> None:
    source, target = start(pair, "latest", "scan")
    resting = pair.runners["target", 0]
    resting.aim("inactive")
    resting.life_cycle.wait_state({"inactive"}, LIMIT)
    began = time.monotonic()
    for number in range(20):
        source.latest.publish(scan(number))
        source.scan.publish(scan(number))
    assert time.monotonic() - began < LIMIT
    wait_until(lambda: pair.drops() == 19)
    resting.aim("active")
    target.wait_for(21)


@every_kind
def test_a_slow_subscriber_makes_its_publisher_wait(pair: Pair) -> None:
    source, target = start(pair, "careful")
    mailbox = pair.runners["target", 0].endpoints.mailbox
    most = 0
    for number in range(30):
        source.careful.publish(scan(number))
        most = max(most, len(list(mailbox.waiting())))
    assert [m.number for m in target.wait_for(30)] == list(range(30))
    assert most <= 3
    assert pair.drops() == 0


@every_kind
def test_a_slow_subscriber_does_not_hold_up_the_others(pair: Pair) -> None:
    source, target = start(pair, "scan", "sums", "latest")
    pair.runners["target", 0].exclusion.pause(LIMIT)
    for number in range(4):
        source.scan.publish(scan(number))
    with ThreadPoolExecutor() as pool:
        waiting = pool.submit(source.scan.publish, scan(4))
        source.latest.publish(scan(9))  # the same container, another connector
        mailbox = pair.runners["target", 0].endpoints.mailbox
        wait_until(lambda: "latest" in dict(mailbox.waiting()))
        assert not waiting.done()
        pair.runners["target", 0].exclusion.resume()
        waiting.result(LIMIT)
    assert len(target.wait_for(6)) == 6


@every_kind
def test_a_source_that_was_started_anew_is_heard(pair: Pair) -> None:
    source, target = start(pair, "scan")
    for number in range(3):
        source.scan.publish(scan(number))
    target.wait_for(3)
    again = pair.start_source_anew(Source)
    again.scan.publish(scan(99))
    assert [m.number for m in target.wait_for(4)] == [0, 1, 2, 99]


@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_a_target_is_reached_whose_computer_has_another_gateway_now(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    assert source.sums.add(1, 2) == 3
    pair.start_targets_computer_anew(Target)
    assert source.sums.add(1, 2) == 3


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_target_counts_on_while_its_source_moves(pair: Pair) -> None:
    """Both paths are open for a while; it says only once what came."""
    pair.run("target", Target)
    source = pair.run("source", Source)
    spec = pair.join("scan")
    pair.activate()
    source.scan.publish(scan())
    wait_until(lambda: status(pair, "target").wait.count == 1)
    here = {("target", 0): pair.runners["target", 0]}
    moved = structs.replace(spec, source_epoch=1)
    for specs in (spec, moved), (moved,):
        assert pair.sides["target"].apply(specs, here) == {}
        assert status(pair, "target").messages == 1
    assert status(pair, "target").key == moved.key


def status(pair: Pair, end: str) -> ConnectorStatus:
    (found,) = pair.sides[end].status()
    return found


@every_kind
def test_both_ends_count_calls(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    for _ in range(3):
        source.sums.add(1, 2)
    with pytest.raises(CalleeError):
        source.sums.fail("once")
    # the answer may be here before its sender has counted it
    wait_until(lambda: status(pair, "target").calls == 4)
    for end in ("source", "target"):
        counted = status(pair, end)
        assert counted.end == ("both" if pair.kind == "direct" else end)
        assert (counted.kind, counted.calls, counted.errors) == (pair.kind, 4, 1)
        assert counted.delay.count == 4


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_call_that_was_sent_on_to_another_place_is_not_counted_here(
    pair: Pair,
) -> None:
    source, _ = start(pair, "sums", limit=0.1)
    moved = pair.runners["target", 0]
    moved.gate.pause(LIMIT)
    moved.exclusion.redirect()
    with pytest.raises(Timeout, match="did not come back"):
        source.sums.add(1, 2)
    assert (status(pair, "source").calls, status(pair, "target").calls) == (1, 0)


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_what_goes_out_at_one_end_comes_in_at_the_other(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    big = Scan(1, np.zeros(50_000, np.float32))
    source.sums.mean(big)  # 200,000 B there, a number back
    source.sums.echo(scan())
    wait_until(lambda: status(pair, "target").calls == 2)
    here, there = status(pair, "source"), status(pair, "target")
    assert (here.bytes_out, here.bytes_in) == (there.bytes_in, there.bytes_out)
    assert here.bytes_out > 200_000
    assert 0 < here.bytes_in < 1_000
    assert there.delay.maximum <= here.delay.maximum


@every_kind
def test_both_ends_count_messages(pair: Pair) -> None:
    source, target = start(pair, "scan")
    for number in range(3):
        source.scan.publish(scan(number))
    target.wait_for(3)
    here, there = status(pair, "source"), status(pair, "target")
    assert (here.messages, there.messages) == (3, 3)
    assert here.bytes_out == there.bytes_in
    assert (here.bytes_out > 0) is (pair.kind != "direct")
    assert (here.wait.count, there.wait.count) == (3, 3)


@pytest.mark.parametrize("pair", ["local"], indirect=True)
def test_each_end_knows_how_long_what_came_was_under_way(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    source.sums.add(1, 2)
    wait_until(lambda: status(pair, "target").calls == 1)
    here, there = status(pair, "source"), status(pair, "target")
    assert (here.latency.count, there.latency.count) == (1, 1)
    # there, the work and back again are what the caller waited for
    ways = here.latency.maximum + there.latency.maximum
    assert 0 < ways < here.delay.maximum
    assert (here.latency_error, there.latency_error) == (0, 0)


@pytest.mark.parametrize("pair", ["remote"], indirect=True)
def test_between_computers_it_is_told_when_the_clocks_are_known(pair: Pair) -> None:
    """The target's clock is told to be 100 s ahead, its messages are 100 s older."""
    source, _ = start(pair, "sums")
    source.sums.add(1, 2)
    wait_until(lambda: status(pair, "target").calls == 1)
    assert status(pair, "source").latency.count == 0
    pair.clocks |= {"target": Elapsed(100.0, 0.5), "source": Elapsed(-100.0, 0.25)}
    status(pair, "source"), status(pair, "target")  # which look at them
    source.sums.add(1, 2)
    wait_until(lambda: status(pair, "target").calls == 2)
    here, there = status(pair, "source"), status(pair, "target")
    assert (here.latency.count, there.latency.count) == (1, 1)
    assert 100 < here.latency.maximum < 100 + LIMIT
    assert (here.latency_error, there.latency_error) == (0.5, 0.25)
    assert there.latency.maximum == 0  # it cannot have come before it was sent


@every_kind
def test_sizes_are_those_of_calls_both_ways_and_of_messages(pair: Pair) -> None:
    source, target = start(pair, "scan")
    for length in (1_000, 1_000, 50_000):
        source.scan.publish(Scan(0, np.zeros(length, np.float32)))
    target.wait_for(3)
    for end in ("source", "target"):
        counted = status(pair, end)
        size = counted.size
        if pair.kind == "direct":
            assert size.count == 0
            continue
        assert size.mean * 3 == counted.bytes_out + counted.bytes_in
        assert size.median == pytest.approx(4_060, rel=0.06)
        assert 200_000 < size.maximum < 201_000


@every_kind
def test_what_makes_room_for_newer_messages_is_counted(pair: Pair) -> None:
    source, _ = start(pair, "latest")
    pair.runners["target", 0].exclusion.pause(LIMIT)
    for number in range(8):  # the last is kept
        source.latest.publish(scan(number))
    wait_until(lambda: status(pair, "target").drops == 7)
    pair.runners["target", 0].exclusion.resume()


@every_kind
def test_a_slow_subscriber_that_keeps_the_last_holds_up_no_publisher(
    pair: Pair,
) -> None:
    source, _ = start(pair, "latest")
    large = Scan(1, np.zeros(100_000, np.float32))
    pair.runners["target", 0].exclusion.pause(LIMIT)
    for _ in range(100):  # far more than sockets hold
        source.latest.publish(large)
    wait_until(lambda: pair.drops() == 99)
    pair.runners["target", 0].exclusion.resume()


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_received_arrays_cannot_be_changed(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises(ValueError, match="read-only"):
        source.sums.echo(scan()).ranges[0] = 1


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_what_cannot_cross_is_refused_where_it_is_sent(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises(CannotCross, match=r"add over .*: .*object cannot cross"):
        source.sums.add(object(), 2)  # type: ignore[arg-type]


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_result_that_cannot_cross_is_no_error_of_the_callee(pair: Pair) -> None:
    source, _ = start(pair, "sums")
    with pytest.raises(CannotCross, match=r"add over .* its result .*cannot cross"):
        source.sums.add(1 << 63, 1 << 63)


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_what_is_refused_again_and_again_is_logged_once(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    source, _ = start(pair, "sums")
    for _ in range(20):
        with pytest.raises(CannotCross, match="not arguments of Sums"):
            source.sums.add("one", 2)  # type: ignore[arg-type]
    assert sum("refused: not arguments of " in text for text in caplog.messages) == 1


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_one_way_call_that_is_refused_counts_as_a_message(pair: Pair) -> None:
    """Nobody gets its error, as a caller gets that of another call."""
    source, _ = start(pair, "sums")
    with pytest.raises(CannotCross):
        source.sums.add("one", 2)  # type: ignore[arg-type]
    source.sums.note(1)  # type: ignore[arg-type]
    wait_until(lambda: pair.sides["target"].status()[0].refused)
    assert source.sums.add(1, 2) == 3
    (end,) = pair.sides["target"].status()
    assert (end.errors, end.refused) == (2, 1)


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_a_caller_that_gave_up_does_not_enter_a_second_time(pair: Pair) -> None:
    source, target = start(pair, "sums", limit=0.1)
    wait_until(lambda: _answers(source))  # to open the link may take longer than a call
    with pytest.raises(Timeout):
        source.sums.wait()
    with pytest.raises(Timeout):
        source.sums.add(1, 2)  # `wait` still runs, on behalf of this very chain
    target.go_on.set()
    wait_until(lambda: _answers(source))


def _answers(source: Source) -> bool:
    try:
        return source.sums.add(1, 2) == 3
    except (Timeout, Unavailable):
        return False


class Slow(Protocol):
    def call_back(self) -> None: ...


class Back(Protocol):
    def back(self) -> None: ...


class Caller(Component):
    slow: Required[Slow]
    home: Provided[Back]

    def configure(self) -> None:
        self.num_back = 0

    def back(self) -> None:
        self.num_back += 1


@pytest.mark.parametrize("pair", ["local", "remote"], indirect=True)
def test_what_comes_back_late_does_not_enter_beside_its_caller(pair: Pair) -> None:
    """The test is the other container: it answers late, and calls back before."""
    caller = pair.run("source", Caller)
    there, back = (
        pair.join("slow", limit=0.1),
        pair.join_back("home", "home", limit=0.1),
    )
    chains, go_on = list[int](), threading.Event()

    def call_back(received: Frame) -> None:
        chains.append(received.chain)
        assert go_on.wait(LIMIT)

    other = pair.servers["target"]
    other.open(there.key, call_back)
    pair.activate()
    exclusion = pair.runners["source", 0].exclusion
    exclusion.enter(new_chain(), LIMIT)
    with pytest.raises(Timeout):
        caller.slow.call_back()
    wait_until(lambda: len(chains) == 1)
    (chain,) = chains
    (method,) = methods(Back).values()
    pieces = segments(method.arguments, (), FrameKind.CALL, tag=method.tag, chain=chain)
    channel = Channel(back.key, Address.parse(back.address), pair.folder)
    wait_until(channel.try_connect)
    answer = channel.request(pieces, LIMIT)
    assert answer.value(FAILURE)[0] == "Timeout"
    assert caller.num_back == 0
    go_on.set()
    exclusion.leave()
    channel.close()


class Ping(Protocol):
    def count(self, left: int) -> int: ...


class PingPong(Component):
    """Calls the other, which calls back, until nothing is left."""

    ping: Required[Ping]
    pong: Provided[Ping]

    def count(self, left: int) -> int:
        return 0 if not left else 1 + self.ping.count(left - 1)


@every_kind
def test_a_chain_of_calls_may_come_back(pair: Pair) -> None:
    one, _ = pair.run("source", PingPong), pair.run("target", PingPong)
    pair.join("ping", "pong")
    pair.join_back("ping", "pong")
    pair.activate()
    assert one.ping.count(7) == 7
