"""A checkpoint is as old as it is, whatever the time of day."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from poise.clock import boot_time
from poise.wire.records.request_records import age_of, set_age

TEN_YEARS = 10 * 365 * 86400.0


def test_its_age_survives_a_step_of_the_time_of_day_by_ten_years(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.checkpoint"
    path.touch()
    set_age(path, 20.0)
    then = time.time()
    monkeypatch.setattr(time, "time", lambda: then - TEN_YEARS)
    assert age_of(path.stat().st_mtime) == pytest.approx(20.0, abs=5.0)


def test_a_copy_may_be_older_than_the_computer_runs(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    path.touch()
    set_age(path, TEN_YEARS)
    assert age_of(path.stat().st_mtime) == pytest.approx(TEN_YEARS, abs=5.0)


def test_one_from_before_the_computer_started_is_as_old_as_that_at_least(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.checkpoint"
    path.touch()
    set_age(path, -TEN_YEARS)  # the computer had run longer then
    assert age_of(path.stat().st_mtime) == pytest.approx(boot_time(), abs=5.0)
