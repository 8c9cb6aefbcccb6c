"""How good a link is, by the heartbeats that come over it."""

from __future__ import annotations

import math
import random

import pytest
from msgspec.structs import replace

from poise.wire.heartbeats import EVERY, Contacts
from poise.wire.records.heartbeat_records import Echo


def loss(came: list[bool]) -> float:
    """Return what one side takes the loss to be, when some heartbeats do not come."""
    here, there = Contacts("robot", "here", "a"), Contacts("robot", "there", "b")
    for number, comes in enumerate(came):
        beat = there.next_beat(number * EVERY)
        if comes:
            here.note(beat, number * EVERY)
    return here.qualities(len(came) * EVERY)["there"].loss


@pytest.mark.parametrize("beats", [5, 20, 100])
def test_a_cut_is_no_loss(beats: int) -> None:
    """However long it was: 10 % would make the link slow."""
    assert loss([True] * 40 + [False] * beats + [True] * 10) < 0.05


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
def test_what_gets_lost_again_and_again_is(share: float) -> None:
    chance = random.Random(1)
    came = [True] + [chance.random() > share for _ in range(400)]
    assert 0.6 * share < loss(came) < 1.3 * share


def test_what_comes_is_none() -> None:
    assert loss([True] * 60) == 0.0


@pytest.mark.parametrize("sent", [math.nan, math.inf, 8.0])
def test_what_was_never_sent_was_not_heard(sent: float) -> None:
    """Also by a peer that tells of the time before a restart of this computer."""
    here, there = Contacts("robot", "here", "a"), Contacts("robot", "there", "b")
    here.next_beat(1.0)
    beat = replace(there.next_beat(5.0), heard={"here": Echo(sent, 0.1)})
    here.note(beat, 2.0)
    contact = here.get("there")
    assert contact is not None
    assert (contact.acked, contact.granted) == (None, None)
    assert here.unanswered_since("there") == 1.0
