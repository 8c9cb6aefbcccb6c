"""Moves lose, double and reorder nothing, and end, whatever happens when."""

from __future__ import annotations

import pytest

from tests.model_of_moves.checker import Report, explore, no_step_is_eager
from tests.model_of_moves.eager import Eager
from tests.model_of_moves.protocol import Protocol, initial
from tests.model_of_moves.world import Bounds, State, is_final, trouble_of

pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.slow,
    pytest.mark.usefixtures("keeps_garbage"),
]

BOUNDS = [
    Bounds(messages=3),
    Bounds(messages=2, speaks=True),
    Bounds(messages=2, gives_up=1),
    Bounds(messages=1, prepares=True, gives_up=1),
    Bounds(messages=0, prepares=True, callers="r", kills=1),
    Bounds(messages=1, callers="cr"),
    Bounds(messages=0, callers="cr", gives_up=1),
    Bounds(messages=0, callers="r", kills=1),
    Bounds(messages=1, kills=1, speaks=True),
    Bounds(messages=2, kills=1, killed="S"),
    Bounds(messages=1, kills=1, killed="o", gives_up=1),
    Bounds(messages=1, kills=1, killed="n", gives_up=1),
    Bounds(messages=1, movers=2, speaks=True),
    Bounds(messages=0, movers=2, callers="c"),
    Bounds(messages=0, movers=2, kills=1, killed="o"),
    Bounds(messages=0, movers=2, callers="d"),
    Bounds(messages=0, movers=2, callers="u"),
    Bounds(messages=0, movers=2, callers="du", gives_up=1, late=False),
    Bounds(messages=0, movers=2, callers="d", kills=1, killed="n"),
    Bounds(messages=0, movers=2, callers="u", kills=1, killed="N"),
]
BUGS = [
    ("no drain", Bounds(messages=0, callers="r"), "a chain is inside"),
    ("no flush", Bounds(messages=1), "lost"),
    ("marker overtakes", Bounds(messages=1), "lost"),
    ("keep the path", Bounds(messages=2, gives_up=1), "lost"),
    ("buffer for ever", Bounds(messages=1, gives_up=1), "stuck"),
    ("buffer too late", Bounds(messages=1, gives_up=1), "stuck"),
    ("pause too late", Bounds(messages=0, gives_up=2), "stuck"),
    ("ignore failures", Bounds(messages=1, gives_up=1), "old and new are at work"),
    (
        "work before the commit",
        Bounds(messages=1, gives_up=1),
        "old and new are at work",
    ),
    ("remove nothing", Bounds(messages=1), "stuck"),
    ("speak at once", Bounds(messages=2, speaks=True), "reordered"),
    ("send at birth", Bounds(messages=2, kills=1, killed="S"), "lost"),
    ("pause at once", Bounds(messages=0, movers=2, callers="d"), "stuck"),
    ("pause at once", Bounds(messages=0, movers=2, callers="u"), "stuck"),
    (
        "pause without them",
        Bounds(messages=0, movers=2, callers="du", gives_up=1, late=False),
        "a chain is inside",
    ),
    (
        "repeat what broke off",
        Bounds(messages=0, movers=2, callers="d", kills=1, killed="o"),
        "a call was run twice",
    ),
    (
        "work at birth",
        Bounds(messages=1, kills=1, killed="o"),
        "old and new are at work",
    ),
]


def check(bounds: Bounds, bug: str = "", *, is_full: bool = False) -> Report[State]:
    """Explore all that may happen; `is_full`: also what eager steps leave out."""
    return explore(
        initial(bounds, bug),
        Protocol(bounds, bug).successors,
        trouble_of,
        lambda state: is_final(state, bounds),
        no_step_is_eager if is_full else Eager(bounds),
    )


@pytest.mark.parametrize("bounds", BOUNDS, ids=str)
def test_every_move_ends_well(bounds: Bounds) -> None:
    report = check(bounds)
    assert not report.trouble, (report.trouble, *report.way)


@pytest.mark.parametrize(("bug", "bounds", "trouble"), BUGS, ids=str)
def test_what_is_done_wrong_is_found(bug: str, bounds: Bounds, trouble: str) -> None:
    report = check(bounds, bug)
    assert report.trouble.startswith(trouble), (report.trouble, *report.way)
