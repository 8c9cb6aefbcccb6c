"""Credits are totals: lost, doubled, late or for another route, they do no harm."""

from __future__ import annotations

import pytest

from poise.runtime._calls import ComponentCounters
from poise.runtime.component.ports import Policy, Queue
from poise.runtime.connectors.flow_control import Credit, CreditIssuer
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.mailbox import Mailbox, PortQueue
from poise.wire import frame
from poise.wire.codec import Codec, WireError
from poise.wire.connections.connection import Connection
from poise.wire.frame import Frame, FrameKind, Pieces

NOTHING: Codec[None] = Codec(type(None))


class Way(Connection):
    """Brings credit to a source, unless it is cut."""

    def __init__(self) -> None:
        self.credit = Credit()
        self.totals: list[int] = []
        self.is_cut = self.is_over = False

    def send_back(self, pieces: Pieces) -> bool:
        assert not self.is_over
        if not self.is_cut:
            received = frame.parse(b"".join(pieces))
            self.totals.append(received.number)
            self.is_over = not self.credit.note_credit(received)
        return not self.is_cut


class Joined:
    """A source and a target, without a transport between them."""

    def __init__(self, policy: Policy = "block", size: int = 4) -> None:
        self.start_source()
        self.start_target(policy, size)

    @property
    def credit(self) -> Credit:
        return self.way.credit

    def start_source(self) -> None:
        self.way = Way()

    def start_target(self, policy: Policy = "block", size: int = 4) -> None:
        self.counts = Counts()
        mailbox = Mailbox({"notes": Queue(policy, size)}, ComponentCounters())
        self.feed = mailbox.feed("notes", self.counts)
        self.mailbox = mailbox
        self.issuer = CreditIssuer("a.b", self.feed, {})

    def ask(self) -> None:
        request = frame.parse(b"".join(self.credit.request()))
        self.issuer.requested(request, self.way)

    def send(self, *, arrives: bool = True) -> None:
        assert self.credit.has_room()
        if not self.credit.sent:
            self.ask()
        self.push(arrives=arrives)

    def push(self, *, arrives: bool = True) -> None:
        """Send without a request, or after one that got lost."""
        self.credit.sent += 1
        number, route = self.credit.sent, self.credit.route
        if arrives:
            pieces = frame.segments(
                NOTHING, None, FrameKind.MESSAGE, number=number, chain=route
            )
            self.issuer.came(frame.parse(b"".join(pieces)))
            self.feed.put((0, number))

    def send_all(self) -> int:
        """Send while there is room; return how many went."""
        before = self.credit.sent
        while self.credit.has_room():
            self.send()
        return self.credit.sent - before

    def take(self, count: int) -> None:
        for _ in range(count):
            inbox = self.mailbox.work(0.0)
            assert isinstance(inbox, PortQueue)
            assert inbox.pop() is not None


@pytest.fixture
def joined() -> Joined:
    return Joined()


def test_as_many_go_as_there_is_room_for(joined: Joined) -> None:
    assert joined.send_all() == 4
    assert len(list(joined.mailbox.waiting())) == 4


def test_gives_credit_when_half_of_the_queue_is_empty_again(joined: Joined) -> None:
    joined.send_all()
    joined.take(1)
    assert not joined.credit.has_room()
    joined.take(1)
    assert joined.way.totals == [4, 6]  # one frame for two messages
    assert joined.send_all() == 2


def test_a_source_that_is_slow_never_waits(joined: Joined) -> None:
    for _ in range(100):
        joined.send()
        joined.take(1)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_small_queue_is_filled_and_never_overfilled(size: int) -> None:
    joined = Joined(size=size)
    for _ in range(20):
        joined.send_all()
        assert len(list(joined.mailbox.waiting())) == size
        joined.take(size)


def test_lost_credit_is_made_good_when_the_source_requests_it(joined: Joined) -> None:
    joined.send_all()
    joined.way.is_cut = True
    joined.take(4)
    assert not joined.credit.has_room()
    joined.way.is_cut = False
    joined.ask()
    assert joined.send_all() == 4
    assert joined.counts.drops == 0


def test_credit_that_comes_twice_or_late_changes_nothing(joined: Joined) -> None:
    joined.send_all()
    joined.take(2)
    for total in (6, 4, 1):
        assert joined.credit.note_credit(credit(total, joined.credit.route))
    assert joined.send_all() == 2


def test_messages_that_got_lost_are_counted_and_leave_their_room(
    joined: Joined, caplog: pytest.LogCaptureFixture
) -> None:
    joined.send()
    joined.send(arrives=False)
    joined.send(arrives=False)
    joined.send()
    assert joined.counts.drops == 2
    assert "connector a.b: 2 messages were lost on their way" in caplog.text
    joined.ask()
    assert joined.send_all() == 2  # two are there


def test_when_all_got_lost_the_request_tells(joined: Joined) -> None:
    joined.send()
    for _ in range(3):
        joined.send(arrives=False)
    assert not joined.credit.has_room()
    joined.ask()
    assert joined.counts.drops == 3
    assert joined.send_all() == 3


def test_what_got_lost_before_anything_came_is_counted_once(joined: Joined) -> None:
    joined.push(arrives=False)
    joined.push()
    joined.ask()
    assert joined.counts.drops == 1
    joined.ask()
    assert joined.counts.drops == 1
    assert joined.send_all() == 3


def test_when_all_got_lost_from_the_first_on_the_request_tells(joined: Joined) -> None:
    joined.push(arrives=False)
    joined.push(arrives=False)
    joined.ask()
    assert joined.counts.drops == 2
    assert joined.send_all() == 4


def test_a_target_that_was_restarted_gives_credit_again(joined: Joined) -> None:
    joined.send_all()
    joined.start_target()
    joined.ask()
    assert joined.send_all() == 4
    assert joined.counts.drops == 0  # what the one before had is not its own


def test_after_one_that_failed_a_restarted_target_bounds_its_source_again(
    joined: Joined,
) -> None:
    joined.send_all()
    joined.mailbox.close()
    assert joined.send_all() == 4
    joined.start_target()
    joined.ask()
    assert joined.send_all() == 4


def test_a_source_that_was_restarted_counts_from_the_first(joined: Joined) -> None:
    joined.send_all()
    old = joined.credit
    joined.start_source()
    joined.take(2)  # credit for the source that is no more
    assert old.has_room()
    assert joined.send_all() == 2  # two of the old one's still wait
    joined.take(4)
    assert joined.send_all() == 4
    assert joined.counts.drops == 0


def test_a_queue_that_keeps_the_last_gives_credit_without_bound_once() -> None:
    joined = Joined("keep", 1)
    for _ in range(1000):
        joined.send()
    assert len(joined.way.totals) == 1
    assert joined.way.is_over


def test_credit_for_another_route_changes_nothing(joined: Joined) -> None:
    joined.push()
    assert joined.credit.note_credit(credit(9, joined.credit.route ^ 2))
    assert not joined.credit.has_room()


def test_a_number_of_messages_that_nobody_sends_is_refused(joined: Joined) -> None:
    joined.push()
    number, route = (1 << 64) - 1, joined.credit.route
    pieces = frame.segments(
        NOTHING, None, FrameKind.MESSAGE, number=number, chain=route
    )
    received = frame.parse(b"".join(pieces))
    with pytest.raises(WireError, match="are said to have gone"):
        joined.issuer.came(received)
    with pytest.raises(WireError, match="are said to have gone"):
        joined.issuer.requested(received, joined.way)
    assert joined.counts.drops == 0


def credit(total: int, route: int) -> Frame:
    pieces = frame.segments(NOTHING, None, FrameKind.CREDIT, number=total, chain=route)
    return frame.parse(b"".join(pieces))
