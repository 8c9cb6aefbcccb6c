"""A checkpoint is as old as it is, whatever the time of day, and there or not."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise import Component, Message
from poise.clock import SystemClock, boot_time
from poise.errors import RunError, UsageError
from poise.runtime.connectors.latest import LatestMessages
from poise.runtime.hosting.checkpoints import Checkpoints
from poise.wire.codec import WireError
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


class State(Message):
    text: str


@pytest.fixture(name="component")
def _component() -> Mock:
    component = Mock(spec=Component)
    component.snapshot.return_value = State("a" * 1000)
    return component


@pytest.fixture(name="checkpoints")
def _checkpoints(tmp_path: Path) -> Checkpoints:
    return Checkpoints(tmp_path, "map", 1, 60.0, SystemClock())


def test_one_that_has_no_room_leaves_no_part(
    checkpoints: Checkpoints, component: Mock, tmp_path: Path
) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            checkpoints.write(component, LatestMessages())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not [*tmp_path.iterdir()]


def test_one_that_was_removed_is_written_again_though_the_state_is_the_same(
    checkpoints: Checkpoints, component: Mock, tmp_path: Path
) -> None:
    checkpoints.write(component, LatestMessages())
    (path,) = tmp_path.iterdir()
    path.unlink()
    checkpoints.write(component, LatestMessages())
    assert path.exists()


class Other(Message):
    number: int


class Restoring(Component):
    def restore(self, state: Other) -> None: ...


@pytest.mark.parametrize("damage", [b"", b"no frame at all" * 10])
def test_one_that_is_damaged_is_named_with_what_to_do(
    checkpoints: Checkpoints, component: Mock, tmp_path: Path, damage: bytes
) -> None:
    checkpoints.write(component, LatestMessages())
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage)
    with pytest.raises(RunError, match=r"checkpoint .* cannot be read: .* --fresh"):
        checkpoints.restore(component, LatestMessages())
    assert path.read_bytes() == damage


def test_one_of_another_type_is_refused_without_talk_of_adapt(
    checkpoints: Checkpoints, component: Mock, tmp_path: Path
) -> None:
    checkpoints.write(component, LatestMessages())
    (path,) = tmp_path.iterdir()
    with pytest.raises(UsageError, match="bring back code") as refused:
        checkpoints.restore(Restoring(), LatestMessages())
    assert "--adapt" not in str(refused.value)
    assert path.exists()


def test_one_that_could_not_be_restored_does_not_replace_one_that_can(
    checkpoints: Checkpoints, component: Mock, tmp_path: Path
) -> None:
    checkpoints.write(component, LatestMessages())
    (path,) = tmp_path.iterdir()
    good = path.read_bytes()
    component.snapshot.return_value = State(5)  # type: ignore[arg-type]
    with pytest.raises(WireError, match="Expected `str`, got `int`"):
        checkpoints.write(component, LatestMessages())
    assert path.read_bytes() == good
