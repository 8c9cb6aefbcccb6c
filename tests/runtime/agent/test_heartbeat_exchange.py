"""Until when an agent lets its leased components act."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from random import Random
from unittest.mock import Mock

import pytest
from msgspec import structs

from poise.runtime.agent.fence import Fence
from poise.runtime.agent.heartbeat_exchange import HeartbeatExchange
from poise.runtime.agent.standby_watch import StandbyWatch
from poise.testing import VirtualClock
from poise.wire.heartbeats import (
    ASK_EVERY,
    LEASE,
    UNCUT_LEASE,
    Address,
    Contacts,
    Hear,
    NextBeat,
)
from poise.wire.records.heartbeat_records import MANAGER as THE_MANAGER
from poise.wire.records.heartbeat_records import Echo, Heartbeat, LinkQuality
from poise.wire.records.request_records import Claim, Election, ManagerId, majority_at

AGENTS = {"left": "tcp/127.0.0.1:1", "right": "tcp/127.0.0.1:2"}
MANAGER = ManagerId(key="k", user="ann", host="desk", pid=7, since=0.0)


def claim_of(
    key: str,
    agents: Mapping[str, str] = AGENTS,
    *,
    is_leased: bool = True,
    votes: Mapping[str, int] | None = None,
) -> Claim:
    """Return the claim of a manager."""
    manager = structs.replace(MANAGER, key=key)
    election = Election(votes=votes) if votes else None
    return Claim(manager, agents=agents, is_leased=is_leased, election=election)


class Transport:
    """Sends nothing: a test lets heartbeats go out by itself.

    `targets`: whom it was to send to.
    """

    def __init__(self, hear: Hear, next_beat: NextBeat) -> None:
        self.hear, self.next_beat = hear, next_beat
        self.targets: Mapping[str, Address] = {}
        self.num_starts = 0

    def start(self) -> None:
        self.num_starts += 1

    def send_to(self, targets: Mapping[str, Address]) -> None:
        self.targets = targets

    def close(self) -> None:
        pass


class Rig:
    """The heartbeats of an agent, which a test lets go out by itself."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.clock.sleep(100.0)
        self.asleep = 0.0
        self.ends: list[float] = []
        self.woken = 0
        self.fence = Fence("robot", "left", self._wake, lambda _: None)
        self.fence.claim(Claim(MANAGER), 1)
        self.exchange = HeartbeatExchange(
            "left",
            Contacts("robot", "left", "key"),
            self.fence,
            self.clock,
            self._transport,
            self.ends.append,
            lambda: self.asleep,
        )

    def _wake(self) -> None:
        self.woken += 1

    def _transport(self, hear: Hear, next_beat: NextBeat) -> Transport:
        self.sending = Transport(hear, next_beat)
        return self.sending

    def next(self, after: float = 0.1) -> tuple[Heartbeat, float]:
        """Return the next heartbeat, and how long to wait for the one after [s]."""
        self.clock.sleep(after)
        return self.sending.next_beat()

    def beat(self, after: float) -> float:
        """Return until when components may act, from now [s]."""
        self.clock.sleep(after)
        self.exchange._next_beat()
        return self.ends[-1] - self.asleep - self.clock.now()


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_components_of_the_only_computer_pay_nothing(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k", {"left": AGENTS["left"]}))
    assert rig.ends == [inf]


def test_where_nothing_is_cut_it_is_enough_that_the_agent_runs(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k", AGENTS, is_leased=False))
    assert rig.beat(0.1) == pytest.approx(UNCUT_LEASE)
    assert rig.beat(9.0) == pytest.approx(UNCUT_LEASE)
    assert rig.beat(11.0) == -inf
    assert rig.fence.is_cut_off


def test_the_next_agent_extends_nothing_before_it_is_heard(rig: Rig) -> None:
    rig.exchange.resume(claim_of("k"))
    assert rig.ends == [-inf]
    assert rig.beat(0.1) == -inf
    assert not rig.fence.is_cut_off
    rig.beat(LEASE)
    rig.beat(0.2)  # it stood still, and has listened
    assert rig.fence.is_cut_off


@pytest.mark.parametrize("is_leased", [True, False])
def test_what_ended_while_no_agent_was_there_is_not_extended_by_the_next_one_alone(
    rig: Rig,
    is_leased: bool,  # noqa: FBT001, a parameter
) -> None:
    rig.exchange.resume(claim_of("k", is_leased=is_leased))
    assert not rig.fence.is_cut_off
    rig.exchange.note_lapsed()
    assert rig.ends[-1] == rig.beat(0.1) == -inf


def test_an_agent_goes_on_by_itself_only_while_it_runs_and_no_manager_may_be_there(
    rig: Rig,
) -> None:
    rig.exchange.resume(claim_of("k"))
    rig.fence._ended.add("k")
    rig.beat(0.1)
    assert rig.beat(LEASE) == -inf  # it stood still for so long: first it listens
    assert rig.beat(0.2) == pytest.approx(LEASE)
    assert rig.beat(3.0) == -inf
    assert rig.beat(0.2) == pytest.approx(LEASE)
    assert not rig.fence.is_cut_off


def test_a_computer_that_was_suspended_has_lost_its_lease(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k"))
    assert rig.beat(0.1) == pytest.approx(LEASE)
    rig.asleep = 60.0
    # what its containers read ended while it slept
    assert rig.ends[-1] < rig.clock.now() + rig.asleep
    assert rig.beat(0.01) == -inf
    assert rig.fence.is_cut_off


def test_the_next_agent_of_a_robot_without_others_lets_components_go_on(
    rig: Rig,
) -> None:
    rig.exchange.resume(claim_of("k", {}, is_leased=False))
    assert rig.ends == [inf]


def heard(
    rig: Rig,
    number: int,
    sender: str = THE_MANAGER,
    confirmed: float | None = None,
    revoked: Mapping[str, int] = {},
    *,
    key: str = "k",
) -> bool:
    """Let the manager be heard, which has heard this agent, or another agent.

    Returns whether it is answered at once.

    `confirmed`: when this agent sent what was heard last [s]; None: now.
    """
    now = rig.clock.now()
    last = now if confirmed is None else confirmed
    beat = Heartbeat(
        robot="robot",
        sender=sender,
        key=key,
        number=number,
        sent=now,
        heard={"left": Echo(last, 0.0)},
        managed=0.0,
        manager="k",
        revoked=revoked,
    )
    return rig.sending.hear([(beat, ("127.0.0.1", 3), now)])


def test_a_manager_that_was_heard_a_moment_before_has_ended(rig: Rig) -> None:
    """While there is none, nothing is started elsewhere."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.exchange.note_liveliness("k", is_there=False)
    assert not rig.fence.is_managed()
    for _ in range(100):
        assert rig.beat(0.1) > 0


def test_one_that_is_heard_after_its_token_went_has_not_ended(rig: Rig) -> None:
    """It does not hear this agent: it may start elsewhere what runs here."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.exchange.note_liveliness("k", is_there=False)
    heard(rig, 2)  # that was under way
    assert not rig.fence.is_managed()
    rig.beat(0.1)
    heard(rig, 3)
    assert rig.fence.is_managed()


def test_one_whose_token_goes_long_after_its_last_heartbeat_may_be_cut_off(
    rig: Rig,
) -> None:
    """Then it may start elsewhere what runs here: the lease ends."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    for _ in range(5):
        rig.beat(0.1)
    rig.exchange.note_liveliness("k", is_there=False)
    assert rig.fence.is_managed()
    for _ in range(5):
        rig.beat(0.1)
    assert rig.ends[-1] == -inf
    assert rig.fence.is_cut_off


def test_a_claim_after_the_lease_ended_lets_nothing_run_until_it_is_said_what(
    rig: Rig,
) -> None:
    """What the agent was told before may run elsewhere by now."""
    rig.exchange.resume(claim_of("k"))
    assert rig.beat(0.1) == -inf
    assert not rig.exchange.is_held()
    rig.fence.lapse()  # as the agent does then, when it is claimed
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    assert rig.beat(0.1) == -inf
    rig.fence.update()
    assert not rig.fence.refusal(1)  # the manager need not claim it again
    rig.fence.note_told()
    assert rig.beat(0.01) > 0


def test_a_heartbeat_that_revokes_the_lease_extends_it_for_no_moment(rig: Rig) -> None:
    """The next claim may come before the agent sends again, and judges."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.beat(0.1)
    rig.clock.sleep(0.9)  # it stood still, and what ran here was started elsewhere
    rig.beat(0.0)
    heard(rig, 2, revoked={"left": 1})
    assert not rig.exchange.is_held()


def test_a_claim_while_the_lease_lasts_interrupts_nothing(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.exchange.note_liveliness("k", is_there=False)
    for _ in range(30):
        rig.beat(0.1)
    assert rig.exchange.is_held()


def test_a_lease_ends_when_the_manager_that_claims_never_sends_a_heartbeat(
    rig: Rig,
) -> None:
    """It was paused just after: what runs here counts as lost once it goes on."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.exchange.obey(claim_of("next"))
    assert rig.beat(0.1) > 0
    for _ in range(7):
        rig.beat(0.1)
    assert rig.ends[-1] == -inf
    assert rig.fence.is_cut_off


def test_after_a_stall_longer_than_the_lease_only_the_manager_extends_it(
    rig: Rig,
) -> None:
    """It may have started what runs here elsewhere, and other agents not know yet."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.beat(0.1)
    rig.clock.sleep(0.9)
    assert rig.beat(0.0) < 0
    heard(rig, 1, "right")
    assert rig.beat(0.01) < 0
    heard(rig, 2)
    assert rig.beat(0.01) > 0


def test_a_manager_that_ended_during_a_stall_may_have_started_things_elsewhere(
    rig: Rig,
) -> None:
    """What it sent before it ended lay there, and is no sign of a moment before."""
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    rig.beat(0.1)
    sent = rig.clock.now()
    rig.clock.sleep(8.0)
    heard(rig, 2, confirmed=sent)
    rig.exchange.note_liveliness("k", is_there=False)
    for _ in range(5):
        rig.beat(0.1)
    assert rig.ends[-1] == -inf
    assert rig.fence.is_cut_off


def test_other_agents_extend_the_lease_of_one_that_did_not_stall(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    for number in range(10):
        assert rig.beat(0.1) > 0
        heard(rig, number, "right")


def test_what_ran_here_without_an_agent_waits_for_what_the_manager_says(
    rig: Rig,
) -> None:
    """It may run elsewhere by now, and heartbeats do not say so."""
    rig.exchange.resume(claim_of("k"))
    rig.exchange.note_lapsed()
    heard(rig, 1)
    assert rig.beat(0.1) == -inf
    rig.fence.note_told()
    assert rig.beat(0.01) > 0


VOTES = {"left": 1, "right": 1, "far": 1}
THREE = {**AGENTS, "far": "tcp/127.0.0.1:4"}


def test_where_managers_are_voted_for_a_claim_begins_no_lease(rig: Rig) -> None:
    """The manager that claims may never get a majority."""
    rig.exchange.obey(claim_of("k", THREE, votes=VOTES))
    assert rig.beat(0.1) == -inf
    assert not rig.fence.is_cut_off
    heard(rig, 1)
    assert rig.beat(0.01) > 0


def test_a_majority_extends_the_lease_while_it_obeys_the_same_manager(
    rig: Rig,
) -> None:
    rig.exchange.obey(claim_of("k", THREE, votes=VOTES))
    heard(rig, 1)
    rig.clock.sleep(0.2)
    for number in range(20):
        assert rig.beat(0.1) > 0
        heard(rig, number, "right")
    rig.exchange.obey(claim_of("later", THREE, votes=VOTES))
    assert rig.beat(0.1) > 0  # the claim ends nothing
    for number in range(20, 30):
        heard(rig, number, "right")  # which obeys the one before
        rig.beat(0.1)
    assert rig.fence.is_cut_off


def test_a_vote_is_for_a_later_term_when_the_leader_is_not_heard() -> None:
    fence = Fence("robot", "left", lambda: None, lambda _: None)
    election = Election(votes=VOTES)

    def claimed(
        key: str,
        term: int,
        token: int,
        *,
        is_unheard: bool = False,
        is_poll: bool = False,
    ) -> bool:
        manager = structs.replace(MANAGER, key=key, term=term)
        claim = Claim(manager, election=election, is_poll=is_poll)
        return fence.claim(claim, token, is_unheard=is_unheard) is None

    assert claimed("first", 1, 1)
    assert not claimed("second", 2, 2)
    assert not claimed("second", 1, 2, is_unheard=True)
    assert claimed("second", 2, 2, is_unheard=True, is_poll=True)
    assert fence.token == 1
    assert claimed("second", 2, 2, is_unheard=True)
    assert not claimed("first", 1, 3, is_unheard=True)


def test_a_majority_has_reached_what_most_votes_have() -> None:
    assert majority_at(VOTES, {"left": 3.0, "right": 2.0, "far": 1.0}) == 2.0
    assert majority_at(VOTES, {"left": 3.0}) == -inf
    assert majority_at({"left": 2, "right": 1}, {"left": 3.0}) == 3.0


def test_a_standby_waits_while_no_majority_would_confirm_it(rig: Rig) -> None:
    """Where UDP was blocked, standbys claimed the robot from each other without end."""
    world = Mock(clock=rig.clock, random=Random(1))
    watch = StandbyWatch("left", rig.exchange, rig.fence, world)
    election = Election(votes=VOTES, managers=("left",))
    claim = Claim(MANAGER, agents=THREE, is_leased=True, election=election)
    rig.exchange.obey(claim)

    def look(number: int, *heard_from: str) -> None:
        for sender in heard_from:
            heard(rig, number, sender)
        rig.clock.sleep(0.1)
        watch.look(is_over=False)

    for number in range(50):
        look(number)
    world.standby.lead.assert_not_called()
    assert "not answered by far, right (does a firewall" in watch.trouble
    assert world.say.call_count == 1
    for number in range(50, 80):
        look(number, "far")
    world.standby.lead.assert_called()
    assert not watch.trouble


def test_a_link_that_stands_still_holds_no_standby_up_for_long(rig: Rig) -> None:
    election = Election(votes=VOTES, managers=("left", "right"))
    exchange = Mock(claim=Mock(election=election))
    exchange.leader_silent_from.return_value = 0.0
    stuck = LinkQuality(delay=3.0, loss=0.0, silent=0.0)
    exchange.links.return_value = {"far": stuck}
    world = Mock(clock=rig.clock, random=Random(1))
    watch = StandbyWatch("right", exchange, rig.fence, world)
    watch.look(is_over=False)
    assert 2.0 < watch.moment() - rig.clock.now() < 2.2


def test_heartbeats_go_to_the_others_from_the_first_claim_on_and_to_the_last_manager(
    rig: Rig,
) -> None:
    rig.exchange.obey(claim_of("k"))
    right, far, back = (("127.0.0.1", port) for port in (2, 4, 3))
    assert rig.sending.targets == {"right": right}
    heard(rig, 1)
    assert rig.sending.targets == {"right": right, THE_MANAGER: back}
    rig.exchange.obey(claim_of("next", THREE))
    assert rig.sending.targets == {"right": right, "far": far}
    assert not heard(rig, 2)  # by the one before
    assert THE_MANAGER not in rig.sending.targets
    assert heard(rig, 1, key="next")
    assert rig.sending.num_starts == 1


def test_the_manager_is_asked_for_a_sign_while_there_is_time_for_it(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k"))
    heard(rig, 1)
    asked = []
    for _ in range(5):
        beat, pause = rig.next(0.11)
        assert (pause == ASK_EVERY) == (beat.asks == (THE_MANAGER,))
        asked.append(bool(beat.asks))
    assert asked == [False, True, True, False, False]


def test_knows_who_is_silent_and_for_how_long(rig: Rig) -> None:
    rig.exchange.obey(claim_of("k", THREE))
    heard(rig, 1, "far")
    rig.next(0.3)
    heard(rig, 1)
    heard(rig, 1, "right")
    rig.next(0.2)
    last = {THE_MANAGER: 0.2, "right": 0.2, "far": 0.5}
    assert rig.exchange.silent() == pytest.approx(last)
    assert rig.exchange.silent_computers == {"far"}
    woken = rig.woken
    rig.next(0.1)
    assert rig.woken == woken  # it was news once
    heard(rig, 2, "far")
    heard(rig, 2, "right")
    rig.next(0.01)
    assert rig.exchange.silent_computers == frozenset()
    assert rig.woken == woken + 1
