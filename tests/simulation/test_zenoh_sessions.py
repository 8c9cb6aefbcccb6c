"""Presence, statuses and requests, as zenoh delivers them."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
import zenoh
from zenoh.handlers import Callback

from poise.simulation.network import Addresses, Network
from poise.simulation.robot.simulated_process import Process, SimulatedComputer
from poise.simulation.scheduler import Scheduler
from poise.simulation.zenoh_sessions import Session, ZenohNetwork, matches

TIMEOUT = 2.0


class Two:
    """An agent on computer b, and a manager on a that is connected to it."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.network = Network(scheduler)
        addresses = Addresses()
        host = [addresses.add(name) for name in "ab"][1]
        self.sessions = ZenohNetwork(self.network, addresses)
        self.manager, self.agent = (
            SimulatedComputer(scheduler, name).start("program") for name in "ab"
        )
        self.locator = f"tcp/{host}:7447"
        self.seen: list[tuple[str, float]] = []
        self.serve()
        self.asking = self.open(self.manager, "connect")
        self.asking.liveliness().declare_subscriber("alive/*", self._note, history=True)
        scheduler.run(1.0)

    def open(self, process: Process, way: str) -> Session:
        config = zenoh.Config()
        config.insert_json5(f"{way}/endpoints", json.dumps([self.locator]))
        config.insert_json5("transport/link/tx/lease", str(int(TIMEOUT * 1000)))
        return self.sessions.open(process, config)

    def serve(self) -> Session:
        session = self.open(self.agent, "listen")
        session.declare_queryable("agent/b", self._answer)
        session.liveliness().declare_token("alive/b")
        return session

    def ask(self) -> list[str]:
        """Return what comes of a request that may take 3 s."""
        replies: list[str] = []
        handler: Callback[zenoh.Reply] = Callback(
            self._take(replies),
            lambda: replies.append(f"end at {self.scheduler.now:.1f}"),
        )
        self.asking.get("agent/b", handler, payload=b"?", timeout=3.0)
        return replies

    def _take(self, replies: list[str]) -> Callable[[zenoh.Reply], None]:
        def take(reply: zenoh.Reply) -> None:
            assert reply.ok is not None
            replies.append(reply.ok.payload.to_bytes().decode())

        return take

    def _note(self, sample: zenoh.Sample) -> None:
        came = sample.kind == zenoh.SampleKind.PUT
        self.seen.append(("came" if came else "went", self.scheduler.now))

    def _answer(self, query: zenoh.Query) -> None:
        query.reply(query.key_expr, b"yes")
        query.drop()  # type: ignore[no-untyped-call]


@pytest.fixture
def two(scheduler: Scheduler) -> Two:
    return Two(scheduler)


def test_one_that_is_there_is_seen_and_answers(two: Two) -> None:
    replies = two.ask()
    two.scheduler.run(1.5)
    assert [what for what, _ in two.seen] == ["came"]
    assert replies == ["yes", "end at 1.0"]


def test_a_killed_process_is_missed_at_once(two: Two) -> None:
    two.agent.kill()
    two.scheduler.run(1.1)
    assert [what for what, _ in two.seen] == ["came", "went"]


def test_a_frozen_process_is_missed_after_its_timeout(two: Two) -> None:
    two.agent.pause()
    two.scheduler.run(9.0)
    (what, at) = two.seen[-1]
    assert what == "went"
    # its last sign was up to a quarter of the timeout old; the look comes as often
    assert 1.0 + 0.7 * TIMEOUT < at < 1.0 + 1.5 * TIMEOUT


def test_one_behind_a_cut_is_missed_after_its_timeout_and_seen_again(two: Two) -> None:
    for way in ("ab", "ba"):
        two.network.cut(*way)
    two.scheduler.run(9.0)
    for way in ("ab", "ba"):
        two.network.heal(*way)
    two.scheduler.run(12.0)
    assert [what for what, _ in two.seen] == ["came", "went", "came"]


def test_a_request_to_a_dead_process_ends_without_a_reply(two: Two) -> None:
    replies = two.ask()
    two.agent.kill()
    two.scheduler.run(2.0)
    assert replies == ["end at 1.0"]


def test_a_request_over_a_cut_ends_at_its_limit(two: Two) -> None:
    two.network.cut("a", "b")
    replies = two.ask()
    two.scheduler.run(9.0)
    assert len(replies) == 1
    assert "end at" in replies[0]


@pytest.mark.parametrize(
    ("pattern", "key", "fits"),
    [
        ("alive/*", "alive/b", True),
        ("alive/*", "alive/b/c", False),
        ("poise-agent/**", "poise-agent/tcp/10.0.0.1:7447/robot/b", True),
        ("alive/b", "alive/c", False),
    ],
)
def test_a_pattern_fits_keys(pattern: str, key: str, fits: bool) -> None:  # noqa: FBT001
    assert matches(pattern, key) == fits
