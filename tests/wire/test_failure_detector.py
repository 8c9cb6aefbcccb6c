"""How good a link is, by the heartbeats that come over it."""

from __future__ import annotations

import random

import pytest

from poise.wire.heartbeats import EVERY, Contacts


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
