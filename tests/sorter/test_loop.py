"""The robot as a whole, in its simulated cell, in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from sorter import safety_monitor
from tests.sorter.loop import LESSER, Loop

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]


@pytest.mark.parametrize("without", [LESSER, {"detector", "inspector"}])
def test_sorts_by_colour_and_scratch_and_hits_nobody(
    tmp_path: Path, without: set[str]
) -> None:
    loop = Loop(tmp_path, seed=1, without=without)
    result = loop.run(30.0)
    loop.close()
    assert loop.done == [True]
    assert all(result["functions"].values()), result
    assert 14 < result["seconds"] < 25


def test_a_hand_that_is_moved_by_old_pictures_misses(tmp_path: Path) -> None:
    loop = Loop(tmp_path, detection_takes=0.35)
    result = loop.run(19.0)
    loop.close()
    assert result["grips_held"] < 0.6
    assert not result["functions"]["tracking"]


def test_without_a_guard_the_arm_stands_still(tmp_path: Path) -> None:
    loop = Loop(tmp_path, without=LESSER | {"safety_monitor"})
    result = loop.run(8.0)
    loop.close()
    assert loop.world.scene.grips_held == 0
    assert not result["functions"]["sorting"]


def test_an_arm_that_ignores_people_hits_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They come after 6 s at the latest, and are too near 2.2 s later."""
    loop = Loop(tmp_path)
    monkeypatch.setattr(safety_monitor, "STOP_AT", 0.0)
    result = loop.run(10.0)
    loop.close()
    assert result["collisions"] == 1
    assert not result["functions"]["safety"]


def test_the_same_seed_is_the_same_cell(tmp_path: Path) -> None:
    first, second, other = (Loop(tmp_path, seed=s) for s in (1, 1, 2))
    things = [[*loop.world.scene.things] for loop in (first, second, other)]
    for loop in (first, second, other):
        loop.close()
    assert things[0] == things[1] != things[2]
