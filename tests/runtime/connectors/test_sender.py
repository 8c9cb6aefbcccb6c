"""A sender sends every message over exactly one of its routes, in order."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import pytest

from poise import Message
from poise.errors import RunError, Timeout, Unavailable
from poise.runtime.component.ports import Port
from poise.runtime.connectors.interface import Method, Proxy
from poise.runtime.connectors.sender import Sender
from poise.runtime.execution.container_lease import LeaseEnded
from poise.runtime.execution.exclusion import Exclusion, new_chain
from poise.wire.codec import WireError
from tests.waiting import wait_until

LONG = 20.0


class Note(Message):
    number: int


class Sums(Protocol):
    def add(self, one: int) -> int: ...


class FakeRoute:
    """Remembers what goes over it."""

    UNFIT = object()
    refusal = ""

    def __init__(self, *, ready: bool = True) -> None:
        self.ready = ready
        self.went: list[Any] = []
        self.is_closed = self.is_calling_now = self.is_given_up = False
        self.room = 1_000
        self.asked = threading.Event()

    def try_connect(self) -> bool:
        return self.ready

    def function(self, method: Method, sender: Sender) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            if not self.ready:  # its target has moved
                deadline = time.monotonic() + LONG
                return sender.repeat_call(self, method.name, args, kwargs, deadline)
            return (self, *args)

        return call

    def is_calling(self) -> bool:
        return self.is_calling_now

    def push(self, _method: Method | None, value: object) -> int:
        if not self.ready:
            raise Unavailable("nobody there")
        if value is self.UNFIT:
            raise WireError("an object cannot cross a connector")
        if value is MemoryError:
            raise MemoryError
        if value is LeaseEnded:
            raise LeaseEnded("a")
        self.went.append(value)
        self.room -= 1
        return 1

    def has_room(self) -> bool:
        return self.room > 0

    def ask(self) -> None:
        self.asked.set()
        if not self.ready:
            raise Unavailable("nobody there")

    def send_marker(self, number: int) -> None:
        if not self.ready:
            raise Unavailable("nobody there")
        self.went.append(f"marker {number}")

    def give_up(self) -> None:
        self.is_given_up = True

    def close(self) -> None:
        self.is_closed = True


def drain(sender: Sender) -> None:
    """Wait until what was buffered went out."""
    wait_until(lambda: sender._buffer is None)


@pytest.fixture
def sender() -> Sender:
    return Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, 0.05)


@pytest.fixture
def old(sender: Sender) -> FakeRoute:
    path = FakeRoute()
    sender.add("old", path)
    return path


@pytest.fixture
def new(sender: Sender, old: FakeRoute) -> FakeRoute:  # noqa: ARG001, the first is old
    path = FakeRoute()
    sender.add("new", path)
    return path


def test_uses_the_first_path(sender: Sender, old: FakeRoute, new: FakeRoute) -> None:
    sender.send(1)
    assert (old.went, new.went) == ([1], [])


def test_tells_while_a_call_waits_at_the_former_target(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    old.is_calling_now = True
    assert sender.has_left()
    sender.switch("new")
    assert not sender.has_left()
    old.is_calling_now, new.is_calling_now = False, True
    assert sender.has_left()


def test_a_marker_goes_behind_all_that_went(sender: Sender, old: FakeRoute) -> None:
    sender.send(1)
    sender.send_marker(7)
    assert old.went == [1, "marker 7"]


def test_where_only_calls_go_out_no_marker_is_sent() -> None:
    sender = Sender("a.sums-b.sums", Port("sums", "requires", Sums), Proxy("a"), 0.05)
    sender.add("old", path := FakeRoute())
    sender.send_marker(7)
    assert path.went == []


def test_no_marker_goes_to_nobody(sender: Sender) -> None:
    with pytest.raises(Unavailable, match="no receiver"):
        sender.send_marker(7)
    sender.add("old", FakeRoute(ready=False))
    with pytest.raises(Unavailable, match="nobody there"):
        sender.send_marker(7)


def test_what_is_kept_back_goes_when_its_source_works(
    sender: Sender, old: FakeRoute
) -> None:
    sender.buffer_until_active()
    sender.send(1)
    assert old.went == []
    sender.send_buffered()
    sender.send(2)
    drain(sender)
    assert old.went == [1, 2]


def test_only_the_newest_messages_are_kept_back_from_a_target_that_is_cut_off(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    """Of 1 to 3 it keeps one: 1 and 2 are dropped, and their publisher never waits."""
    sender.buffer_for_move(keep=1)
    for number in (1, 2, 3):
        sender.send(number)
    assert sender.counts.drops == 2
    sender.switch("new")
    drain(sender)
    assert (old.went, new.went) == ([], [3])
    sender.send(4)
    sender.send(5)
    assert new.went == [3, 4, 5]


def test_of_what_is_kept_back_already_only_the_newest_stay(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    """Of 1 to 5 the newest two, 4 and 5, stay."""
    sender.buffer_until_active()
    for number in range(1, 6):
        sender.send(number)
    sender.buffer_for_move(keep=2)
    assert sender.counts.drops == 3
    sender.send_buffered()
    sender.switch("new")
    drain(sender)
    assert (old.went, new.went) == ([], [4, 5])


def test_what_is_kept_back_also_waits_for_a_target_that_moves(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    sender.buffer_until_active()
    sender.buffer_for_move()
    sender.send(1)
    sender.send_buffered()
    assert (old.went, new.went) == ([], [])
    sender.switch("new")
    drain(sender)
    assert (old.went, new.went) == ([], [1])


def test_what_is_kept_back_waits_for_its_source_when_the_target_has_moved(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    sender.buffer_until_active()
    sender.buffer_for_move()
    sender.send(1)
    sender.switch("new")
    assert not sender._is_draining
    sender.send_buffered()
    drain(sender)
    assert (old.went, new.went) == ([], [1])


@pytest.mark.parametrize("towards", ["old", "new"])
def test_what_was_held_goes_one_way_in_order(
    sender: Sender, old: FakeRoute, new: FakeRoute, towards: str
) -> None:
    sender.send(1)
    sender.buffer_for_move()
    sender.send(2)
    sender.send(3)
    assert (old.went, new.went) == ([1], [])
    sender.switch(towards)
    sender.send(4)
    drain(sender)
    expected = {"old": ([1, 2, 3, 4], []), "new": ([1], [2, 3, 4])}
    assert (old.went, new.went) == expected[towards]


@pytest.mark.parametrize(("kept", "gone"), [("old", "new"), ("new", "old")])
def test_what_was_held_goes_where_one_way_is_left(
    sender: Sender, old: FakeRoute, new: FakeRoute, kept: str, gone: str
) -> None:
    """As when the order to release was lost."""
    sender.buffer_for_move()
    sender.send(1)
    sender.remove(gone)
    sender.send(2)
    drain(sender)
    went = {"old": old, "new": new}
    assert went[kept].went == [1, 2]
    assert went[gone].went == []
    assert went[gone].is_closed


def test_what_was_held_goes_out_before_the_next_move(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    """As when it begins at once, and the order to release was lost."""
    sender.buffer_for_move()
    sender.send(1)
    next_one = FakeRoute()
    sender.add("next", next_one)
    sender.remove("new")
    drain(sender)
    assert (old.went, new.went, next_one.went) == ([1], [], [])
    sender.buffer_for_move()
    sender.send(2)
    sender.switch("next")
    drain(sender)
    assert (old.went, next_one.went) == ([1], [2])


def test_what_was_held_and_cannot_cross_hinders_nothing_else(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    sender.buffer_for_move()
    for value in (1, FakeRoute.UNFIT, 3, MemoryError):
        sender.send(value)
    sender.switch("new")
    sender.send(4)
    drain(sender)
    assert (old.went, new.went) == ([], [1, 3, 4])
    assert sender.counts.drops == 2


@pytest.mark.usefixtures("old")
def test_does_not_hold_when_no_move_goes_on(sender: Sender) -> None:
    """As when the order to hold comes after the move is over."""
    with pytest.raises(RunError, match="its target does not move"):
        sender.buffer_for_move()


def test_does_not_release_to_nowhere(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    sender.buffer_for_move()
    sender.send(1)
    with pytest.raises(Unavailable, match="has no route nowhere"):
        sender.switch("nowhere")
    assert (old.went, new.went) == ([], [])


def test_a_publisher_waits_while_too_much_is_held(
    sender: Sender, new: FakeRoute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.runtime.connectors.sender.MOST_BUFFERED", 2)
    sender.buffer_for_move()
    for number in range(3):
        sender.send(number)  # the third waits for the sender's limit, and is lost
    assert sender.counts.drops == 1
    sender.switch("new")
    drain(sender)
    assert new.went == [0, 1]


def test_a_publisher_waits_for_room_and_asks_for_it(
    sender: Sender, old: FakeRoute
) -> None:
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    old.room = 0
    sender.add("old", old)
    with ThreadPoolExecutor() as pool:
        sent = pool.submit(sender.send, 1)
        assert old.asked.wait(LONG)
        assert old.went == []
        old.room = 1
        sender.note_room()
        sent.result(LONG)
    assert (old.went, sender.counts.drops) == ([1], 0)


def test_a_reentrant_publisher_lets_others_in_while_it_waits(old: FakeRoute) -> None:
    exclusion = Exclusion("a")
    exclusion.resume()
    port = Port("notes", "publishes", Note)
    sender = Sender("a.notes-b.notes", port, None, LONG, exclusion)
    sender.add("old", old)
    old.room = 0

    def publish() -> None:
        exclusion.enter(new_chain(), LONG)
        sender.send(1)
        exclusion.leave()  # it is inside again, or this raises

    with ThreadPoolExecutor() as pool:
        sent = pool.submit(publish)
        assert old.asked.wait(LONG)
        exclusion.enter(new_chain(), LONG)
        exclusion.leave()
        assert old.went == []
        old.room = 1
        sender.note_room()
        sent.result(LONG)
    assert old.went == [1]


def test_no_other_message_goes_out_while_one_asks_for_room(sender: Sender) -> None:
    class Asked(FakeRoute):
        def ask(self) -> None:
            self.room = 1
            self.others_can = sender._can_take()

    route = Asked()
    route.room = 0
    sender.add("old", route)
    sender._limit = LONG
    sender.send(1)
    assert route.went == [1]
    assert not route.others_can


def test_without_room_a_message_is_dropped_after_the_limit_and_counted(
    sender: Sender, old: FakeRoute
) -> None:
    old.room = 0
    sender.send(1)
    assert (old.went, sender.counts.drops) == ([], 1)


def test_nobody_waits_for_the_room_of_one_that_is_gone(old: FakeRoute) -> None:
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    sender.add("old", old)
    old.room, old.ready = 0, False
    sender.send(1)
    assert sender.counts.drops == 1


def test_who_waits_for_room_does_not_hinder_a_move(old: FakeRoute) -> None:
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    new = FakeRoute()
    sender.add("old", old)
    sender.add("new", new)
    old.room = 0
    with ThreadPoolExecutor() as pool:
        sent = pool.submit(sender.send, 1)
        assert old.asked.wait(LONG)
        sender.buffer_for_move()  # its message is held, too
        sent.result(LONG)
    sender.switch("new")
    drain(sender)
    assert (old.went, new.went) == ([], [1])


def test_what_does_not_go_out_is_counted(sender: Sender) -> None:
    sender.send(1)
    sender.add("old", FakeRoute(ready=False))
    sender.send(2)
    assert (sender.counts.drops, sender.counts.messages) == (2, 0)


@pytest.fixture
def calling() -> tuple[Sender, Any]:
    proxy: Any = Proxy("a.sums (Sums)")
    sender = Sender("a.sums-b.sums", Port("sums", "requires", Sums), proxy, 0.05)
    return sender, proxy


def test_a_call_that_was_not_run_goes_where_the_target_is_now(
    calling: tuple[Sender, Any],
) -> None:
    sender, proxy = calling
    old, new = FakeRoute(ready=False), FakeRoute()
    sender.add("old", old)
    sender.add("new", new)
    begun = threading.Event()

    def call() -> Any:
        begun.set()
        return proxy.add(1)

    with ThreadPoolExecutor() as pool:
        result = pool.submit(call)
        assert begun.wait(LONG)
        sender.switch("new")
        assert result.result(LONG) == (new, 1)


def test_a_call_does_not_wait_for_ever_for_its_target(
    calling: tuple[Sender, Any],
) -> None:
    sender, _ = calling
    path = FakeRoute()
    sender.add("old", path)
    with pytest.raises(Timeout, match="its target has failed or did not come back"):
        sender.repeat_call(path, "add", (1,), {}, time.monotonic())
    assert (sender.counts.calls, sender.counts.errors) == (1, 1)


def test_without_a_path_calls_are_unavailable(calling: tuple[Sender, Any]) -> None:
    sender, proxy = calling
    with pytest.raises(Unavailable, match=r"'a.sums-b.sums' is not connected"):
        proxy.add(1)
    sender.add("old", FakeRoute())
    sender.remove("old")
    with pytest.raises(Unavailable, match=r"'a.sums-b.sums' is not connected"):
        proxy.add(1)


class SlowRoute(FakeRoute):
    """Its receiver takes nothing until the test lets it."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.go_on = threading.Event(), threading.Event()

    def push(self, method: Method | None, value: object) -> int:
        self.begun.set()
        assert self.go_on.wait(LONG)
        return super().push(method, value)


def test_only_the_publisher_waits_for_a_receiver_that_takes_nothing(
    old: FakeRoute,
) -> None:
    """The thread that brings credits and the control thread go on."""
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    slow = SlowRoute()
    sender.add("slow", slow)
    with ThreadPoolExecutor(2) as pool:
        sent = pool.submit(sender.send, 1)
        assert slow.begun.wait(LONG)
        sender.note_room()
        sender.add("old", old)
        sender.buffer_for_move()
        sender.send(2)
        marked = pool.submit(sender.send_marker, 7)
        sender.switch("old")
        assert not sent.done()
        slow.go_on.set()
        sent.result(LONG)
        marked.result(LONG)
    drain(sender)
    assert sorted(map(str, [*slow.went, *old.went])) == ["1", "2", "marker 7"]
    assert old.went[0] == 2


def test_one_message_goes_out_at_a_time() -> None:
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    slow = SlowRoute()
    sender.add("slow", slow)
    with ThreadPoolExecutor() as pool:
        sent = pool.submit(sender.send, 1)
        assert slow.begun.wait(LONG)
        assert not sender._can_take()
        slow.go_on.set()
        sent.result(LONG)
    assert sender._can_take()


def test_nobody_waits_while_what_was_buffered_goes_out(old: FakeRoute) -> None:
    """Neither the step of a move that switches, nor one that closes a route."""
    sender = Sender("a.notes-b.notes", Port("notes", "publishes", Note), None, LONG)
    slow = SlowRoute()
    sender.add("old", old)
    sender.add("slow", slow)
    sender.buffer_for_move()
    for number in (1, 2):
        sender.send(number)
    sender.switch("slow")
    assert slow.begun.wait(LONG)
    sender.send(3)
    sender.remove("old")
    assert slow.went == []
    slow.go_on.set()
    sender.send_marker(7)  # waits: it goes behind them
    assert slow.went == [1, 2, 3, "marker 7"]


def test_what_the_end_of_the_lease_keeps_back_is_counted_once(
    sender: Sender, old: FakeRoute, new: FakeRoute
) -> None:
    with pytest.raises(LeaseEnded):
        sender.send(LeaseEnded)
    sender.buffer_for_move()
    sender.send(LeaseEnded)
    sender.send(1)
    sender.switch("new")
    drain(sender)
    assert (old.went, new.went, sender.counts.drops) == ([], [1], 2)
