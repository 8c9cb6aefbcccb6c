"""Heartbeats of a manager and three agents: who is lost, and whose lease has ended.

All on a virtual clock, over links that a test cuts. Each side reads a clock of its own.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from math import inf
from typing import TYPE_CHECKING, cast

import pytest

from poise.clock import SystemClock, time_asleep
from poise.manage.agent_connections import reachability
from poise.manage.agent_connections.reachability import AgentHeartbeats
from poise.runtime.agent.fence import Lease
from poise.wire.heartbeats import EVERY, LEASE, SURELY_ENDED, UNHEARD_AFTER, Contacts
from poise.wire.records.heartbeat_records import MANAGER, Heartbeat

if TYPE_CHECKING:
    from poise.wire.heartbeats import Datagrams

AGENTS = ("left", "right", "third")
AHEAD = {MANAGER: 0.0, "left": 1e3, "right": -70.0, "third": 5e5}
"""How far each clock is ahead of the test's [s]."""
MINE, ANOTHER = f"key of {MANAGER}", "another manager"
VOTES = dict.fromkeys(AGENTS, 1)
STEP = 0.025
DELAY = 0.01
JITTER = 0.06


class Clock(SystemClock):
    """The manager's, which shows the test's time."""

    def __init__(self, world: World) -> None:
        self._world = world

    def now(self) -> float:
        return self._world.now


class World:
    """A manager and agents that exchange heartbeats, and may vote for managers."""

    def __init__(self, votes: Mapping[str, int] = {}) -> None:
        self.now = 0.0
        self.contacts = {n: Contacts("robot", n, f"key of {n}") for n in AHEAD}
        self.obeys = dict.fromkeys(AGENTS, MINE)
        self.leases = {name: Lease(self.contacts[name]) for name in AGENTS}
        for name, lease in self.leases.items():
            others = [other for other in AGENTS if other != name]
            lease.begin(others, MINE, votes=votes)
        self.silent: set[str] = set()
        self.manager = AgentHeartbeats(
            self.contacts[MANAGER],
            dict.fromkeys(AGENTS, "tcp/10.0.0.1:7447"),
            Clock(self),
            self._note_silent,
            SURELY_ENDED,
            cast("Datagrams", None),  # it is not started: the test carries all
            votes=votes,
        )
        self.cut: set[tuple[str, str]] = set()
        self.stalled: set[str] = set()
        self.jitter = 0.0
        self._chance = random.Random(1)
        self._on_way: list[tuple[float, str, Heartbeat]] = []
        self._due = {name: 0.011 * i for i, name in enumerate(AHEAD)}

    def sever(self, one: str, other: str) -> None:
        self.cut |= {(one, other), (other, one)}

    def isolate(self, name: str) -> None:
        for other in AHEAD.keys() - {name}:
            self.sever(name, other)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.step()

    def step(self) -> None:
        self.now += STEP
        waiting = []
        for at, to, beat in self._on_way:
            if at > self.now or to in self.stalled:
                waiting.append((at, to, beat))
                continue
            is_news = self.contacts[to].note(beat, self.now + AHEAD[to])
            if is_news and beat.sender == MANAGER:
                self._due[to] = self.now  # it answers
        self._on_way = waiting
        for name in AHEAD.keys() - self.stalled:
            if self.now >= self._due[name]:
                pause = self.contacts[name].pause(self.now + AHEAD[name])
                self._due[name] = self.now + pause
                self._send(name)

    def _send(self, name: str) -> None:
        at = self.now + AHEAD[name]
        if name == MANAGER:
            beat, _ = self.manager.next_beat()
        else:
            managed, manager = self.leases[name].managed(at), self.obeys[name]
            beat = self.contacts[name].next_beat(at, managed=managed, manager=manager)
        arrives = self.now + DELAY + self.jitter * self._chance.random()
        self._on_way += [
            (arrives, other, beat)
            for other in AHEAD.keys() - {name}
            if (name, other) not in self.cut
        ]

    def _note_silent(self, silent: Iterable[str]) -> None:
        self.silent = set(silent)

    def is_held(self, name: str) -> bool:
        now = self.now + AHEAD[name]
        return self.leases[name].until(now) > now

    def lost(self) -> set[str]:
        return {n for n in self.silent if not self.manager.heard_by(n)}

    def have_leases_ended(self, *names: str) -> bool:
        return self.manager.have_leases_ended(names)


@pytest.fixture
def world() -> World:
    world = World()
    world.run(1.0)
    return world


def test_nobody_is_lost_while_all_hear_each_other(world: World) -> None:
    for _ in range(100):
        world.run(0.1)
        assert not world.silent
        assert all(map(world.is_held, AGENTS))


def test_a_computer_that_is_cut_off_is_lost_and_its_lease_ends_first(
    world: World,
) -> None:
    world.isolate("left")
    world.run(UNHEARD_AFTER + 2 * EVERY)
    assert world.lost() == {"left"}
    assert not world.have_leases_ended("left")
    world.run(LEASE - UNHEARD_AFTER)
    assert not world.is_held("left")
    assert world.is_held("right")
    assert world.is_held("third")
    world.run(SURELY_ENDED - LEASE + EVERY)
    assert world.have_leases_ended("left")
    assert not world.have_leases_ended("left", "right")


def test_a_lease_ends_as_soon_when_others_tell_of_the_silence_late(
    world: World,
) -> None:
    """When another heard it last then seems a bit later now and then: no new sign."""
    world.jitter = JITTER
    world.run(2.0)
    world.isolate("left")
    world.run(SURELY_ENDED + JITTER + 2 * EVERY)
    assert world.have_leases_ended("left")


def test_who_is_cut_off_from_the_manager_only_goes_on(world: World) -> None:
    world.sever("left", MANAGER)
    world.run(5.0)
    assert world.silent == {"left"}
    assert not world.lost()
    assert world.manager.heard_by("left") in {"right", "third"}
    assert world.is_held("left")
    assert not world.have_leases_ended("left")


def test_who_loses_only_its_connection_is_still_heard(world: World) -> None:
    """A firewall may let nothing but heartbeats through."""
    world.manager.note_ended("left")
    assert not world.manager.is_heard("left")  # it may have ended just now
    world.run(UNHEARD_AFTER)
    assert world.manager.is_heard("left")
    world.isolate("left")
    world.run(UNHEARD_AFTER + 2 * EVERY)
    assert not world.manager.is_heard("left")


def test_who_ends_is_not_heard_any_more(world: World) -> None:
    world.isolate("left")
    world.manager.note_ended("left")
    for _ in range(20):
        world.run(0.05)
        assert not world.manager.is_heard("left")


def test_a_manager_that_cannot_be_heard_stops_nothing(world: World) -> None:
    """It reaches no agent, so it can have started nothing elsewhere."""
    world.isolate(MANAGER)
    world.run(5.0)
    assert all(map(world.is_held, AGENTS))


def test_the_side_without_the_manager_stops(world: World) -> None:
    for name in ("left", "right"):
        world.sever(name, MANAGER)
        world.sever(name, "third")
    world.run(SURELY_ENDED + 0.2)
    assert world.lost() == {"left", "right"}
    assert world.have_leases_ended("left", "right")
    assert [world.is_held(name) for name in AGENTS] == [False, False, True]


def test_an_agent_that_was_stalled_extends_nothing_by_what_it_finds(
    world: World,
) -> None:
    """Heartbeats that came meanwhile have heard only what it sent before."""
    world.stalled = {"left"}
    world.run(3.0)
    world.isolate("left")
    world.stalled = set()
    world.step()
    assert not world.is_held("left")


def test_the_lease_of_an_agent_that_was_never_heard_ends_after_its_loss(
    world: World,
) -> None:
    assert not world.have_leases_ended("fourth")
    world.manager.note_ended("fourth")
    assert not world.have_leases_ended("fourth")
    world.run(SURELY_ENDED + STEP)
    assert world.have_leases_ended("fourth")


def test_the_next_agent_holds_a_lease_only_once_the_manager_has_heard_it() -> None:
    contacts, now = Contacts("robot", "left", "next"), 100.0
    lease = Lease(contacts)
    lease.begin(["right"], MINE, began=-inf)
    assert lease.until(now) == -inf
    manager = Contacts("robot", MANAGER, "manager")
    contacts.note(manager.next_beat(5.0), now)  # it may have been under way for long
    assert lease.until(now) == -inf
    manager.note(contacts.next_beat(now), 5.1)
    contacts.note(manager.next_beat(5.2), now + 0.2)
    assert lease.until(now + 0.2) == pytest.approx(now + LEASE)


def test_an_agent_answers_the_manager_and_sends_by_itself_without_it(
    world: World,
) -> None:
    contacts = world.contacts["left"]
    assert contacts.pause(world.now + AHEAD["left"]) > EVERY
    world.sever("left", MANAGER)
    world.run(2 * EVERY)
    assert contacts.pause(world.now + AHEAD["left"]) == EVERY


def test_who_is_heard_but_hears_nobody_is_lost(world: World) -> None:
    world.cut |= {(other, "left") for other in AHEAD if other != "left"}
    world.run(2.0)
    assert "left" in world.silent
    assert not world.is_held("left")


def test_a_stalled_manager_declares_nobody_lost(world: World) -> None:
    world.stalled = {MANAGER}
    world.run(5.0)
    world.stalled = set()
    for _ in range(40):
        world.step()
        assert not world.silent


def test_a_stalled_machine_loses_nobody(world: World) -> None:
    world.stalled = set(AHEAD)
    world.run(5.0)
    world.stalled = set()
    for _ in range(40):
        world.step()
        assert not world.silent


def test_one_lost_datagram_in_three_is_no_loss_of_a_computer() -> None:
    world, chance = World(), random.Random(7)
    others = [(a, b) for a in AHEAD for b in AHEAD if a != b]
    for _ in range(2400):
        world.cut = {pair for pair in others if chance.random() < 0.1}
        world.step()
        assert not world.lost()


@pytest.fixture
def voting() -> World:
    world = World(VOTES)
    world.run(1.0)
    return world


def test_a_manager_leads_while_a_majority_obeys_it(voting: World) -> None:
    voting.isolate("left")
    voting.run(SURELY_ENDED + 2 * EVERY)
    assert voting.manager.unconfirmed() == 0.0
    assert voting.have_leases_ended("left")
    voting.obeys["right"] = ANOTHER
    voting.run(1.0)
    assert voting.manager.unconfirmed() == pytest.approx(1.0, abs=2 * EVERY)
    assert not voting.have_leases_ended("left")  # another may have started it
    voting.obeys["right"] = MINE
    voting.run(2 * EVERY)
    assert voting.manager.unconfirmed() == 0.0
    assert voting.have_leases_ended("left")


def test_a_manager_that_a_majority_does_not_hear_leads_for_as_long_as_leases_last(
    voting: World,
) -> None:
    voting.isolate("left")
    voting.run(2 * SURELY_ENDED)
    voting.isolate(MANAGER)
    voting.run(LEASE - 2 * EVERY)
    assert voting.manager.unconfirmed() == 0.0
    assert voting.have_leases_ended("left")
    voting.run(1.0)
    assert voting.manager.unconfirmed() == pytest.approx(1.0 - 2 * EVERY, abs=2 * EVERY)
    assert not voting.have_leases_ended("left")


def test_a_manager_whose_computer_slept_leads_once_a_majority_has_heard_it_anew(
    voting: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No clock ran meanwhile, and another manager may have been voted for."""
    asleep = time_asleep() + 60.0
    monkeypatch.setattr(reachability, "time_asleep", lambda: asleep)
    assert voting.manager.leads()
    voting.manager.next_beat()
    assert not voting.manager.leads()
    voting.run(3 * EVERY)
    assert voting.manager.leads()


def test_an_agent_that_votes_goes_on_while_a_majority_obeys_its_manager(
    voting: World,
) -> None:
    voting.isolate(MANAGER)
    voting.isolate("third")
    voting.run(SURELY_ENDED)
    assert [voting.is_held(name) for name in AGENTS] == [True, True, False]
    voting.obeys["right"] = ANOTHER
    voting.run(SURELY_ENDED)
    assert not voting.is_held("left")


def test_a_lease_that_ended_while_its_computer_slept_is_extended_only_anew(
    voting: World,
) -> None:
    voting.leases["left"].end(voting.now + AHEAD["left"])
    assert not voting.is_held("left")
    voting.run(3 * EVERY)
    assert voting.is_held("left")


@pytest.mark.parametrize("teller", [MANAGER, "right"])
def test_a_token_is_revoked_by_whoever_tells_of_it(teller: str) -> None:
    contacts = Contacts("robot", "left", "key")
    lease = Lease(contacts)
    lease.begin(["right"], MINE)
    assert not lease.is_revoked("left", 5)
    told = Contacts("robot", teller, "key").next_beat(1.0, revoked={"left": 5})
    contacts.note(told, 1.0)
    assert lease.is_revoked("left", 5)
    assert lease.is_revoked("left", 6)  # as an agent that was cut off counts on
    assert not lease.is_revoked("left", 7)
    assert not lease.is_revoked("right", 0)


@pytest.mark.parametrize("jitter", [0.0, JITTER])
@pytest.mark.parametrize("seed", range(6))
def test_what_may_be_started_elsewhere_is_active_nowhere(
    seed: int, jitter: float
) -> None:
    """Whatever is cut, one way or both, and whoever is stalled."""
    world, chance = World(), random.Random(seed)
    world.jitter = jitter
    world.run(1.0)
    pairs = [(a, b) for a in AHEAD for b in AHEAD if a != b]
    cut_off: set[str] = set()
    num_started = 0
    for _ in range(120):
        share = chance.choice((0, 0.3, 0.8))
        world.cut = {pair for pair in pairs if chance.random() < share}
        world.stalled = {name for name in AHEAD if chance.random() < 0.1}
        for _ in range(chance.randrange(2, 60)):
            world.step()
            cut_off |= {name for name in AGENTS if not world.is_held(name)}
            cut_off &= world.silent | world.stalled  # else they are told
            if world.silent == set(AGENTS):
                continue  # there is nowhere to start anything
            for name in world.lost():
                if world.have_leases_ended(name):
                    num_started += 1
                    assert name in cut_off, (seed, world.now, name)
    assert num_started > 0


def test_an_agent_that_obeys_another_manager_extends_no_lease() -> None:
    """The manager of `left` hears of it no more, and may start elsewhere what runs."""
    world = World()
    world.run(1.0)
    world.sever("left", MANAGER)
    world.run(1.0)
    assert world.is_held("left")  # the others relay
    world.obeys |= {"right": ANOTHER, "third": ANOTHER}
    world.run(1.0)
    assert not world.is_held("left")


def test_agents_whose_manager_has_ended_leave_the_lease_as_it_is() -> None:
    world = World()
    world.run(1.0)
    world.isolate(MANAGER)
    world.obeys |= dict.fromkeys(AGENTS, "")
    world.run(2.0)
    assert world.is_held("left")


def test_a_lost_connection_ends_no_lease_that_another_agent_extends() -> None:
    """Nothing answered the manager since it claimed the agent again."""
    world = World()
    world.run(1.0)
    world.manager.forget("left")
    world.sever(MANAGER, "left")
    world.manager.note_ended("left")
    world.run(2 * SURELY_ENDED)
    assert world.leases["left"].until(world.now + AHEAD["left"]) > world.now
    assert not world.manager.have_leases_ended(["left"])
    assert world.manager.heard_by("left") in {"right", "third"}
    world.isolate("left")
    world.run(2 * SURELY_ENDED)
    assert world.manager.have_leases_ended(["left"])
    assert not world.manager.heard_by("left")
