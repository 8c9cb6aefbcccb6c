"""An agent never waits for the standby that it wakes."""

from __future__ import annotations

import contextlib
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.runtime.agent import standby_process
from poise.runtime.agent.standby_process import StandbyProcess
from poise.session.keys import init_keys
from poise.wire.credentials import CERTIFICATE
from poise.wire.records.request_records import Claim, ManagerId

MANAGER = ManagerId(key="k", user="u", host="h", pid=1, since=0.0)


@contextlib.contextmanager
def full_disk() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_one_that_is_busy_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tmp_path / "told"
    words = f"read first; while test ! -e {tmp_path}/go; do sleep 0.01; done; cat"
    command = "sh", "-c", f"{words} > {told}.new; mv {told}.new {told}"
    monkeypatch.setattr(standby_process, "_COMMAND", command)
    standby = StandbyProcess("left", tmp_path, None)
    standby.keep(Claim(manager=MANAGER))
    for _ in range(os.pathconf("/", "PC_PIPE_BUF") * 4):  # more than the kernel keeps
        standby.lead()
    (tmp_path / "go").touch()
    standby.keep(None)
    process = standby._process
    assert process is not None
    assert process.stdin is not None
    process.stdin.close()
    process.wait()
    assert told.read_text() in {"lead\nend\n", "end\n"}


@pytest.mark.slow
def test_another_one_waits_though_the_disk_is_full_when_only_the_leader_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standby_process, "_COMMAND", ("sh", "-c", "read word"))
    standby = StandbyProcess("left", tmp_path, None)
    standby.keep(Claim(manager=MANAGER))
    first = standby._process
    assert first is not None
    standby.lead()
    first.communicate()  # it led, and was killed
    with full_disk():
        standby.keep(Claim(manager=replace(MANAGER, key="other")))
    second = standby._process
    assert second is not None
    assert second is not first
    second.communicate()


@pytest.mark.slow
def test_what_hinders_one_from_waiting_is_told_until_it_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standby_process, "_COMMAND", ("sh", "-c", "read word"))
    standby = StandbyProcess("left", tmp_path, None)
    with full_disk():
        standby.keep(Claim(manager=MANAGER))
        assert "File too large" in standby.notice()
    standby.keep(Claim(manager=MANAGER))
    assert standby.notice() == ""
    process = standby._process
    assert process is not None
    process.communicate()


@pytest.mark.slow
def test_keys_with_which_it_cannot_lead_are_told_before_it_must(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot got no leader when it needed one, and status had said nothing."""
    monkeypatch.setattr(standby_process, "_COMMAND", ("sh", "-c", "read word"))
    authority = init_keys("hello", tmp_path / "owner")
    keys = authority.issue("left", "agent", tmp_path / "keys")
    standby = StandbyProcess("left", tmp_path, keys)
    assert not standby.notice()  # nobody asked for one
    authority.issue("left", "manager", keys.to_lead)
    standby.keep(Claim(manager=MANAGER))
    assert not standby.notice()
    authority.issue("left", "manager", keys.to_lead, days=3)
    assert "manager left ends in 3.0 days" in standby.notice()
    authority.rotate()
    authority.issue("left", "agent", keys.folder)
    assert "ends in 3.0 days" in standby.notice()  # each knows the other's authority
    authority.rotate()
    authority.issue("left", "agent", keys.folder)
    assert "are of two authorities: `poise keys issue --leads`" in standby.notice()
    authority.issue("left", "manager", keys.to_lead)
    assert not standby.notice()
    (keys.to_lead / CERTIFICATE).write_text("a part of it")
    assert "the standby here cannot lead" in standby.notice()
    authority.issue("left", "agent", keys.to_lead)
    assert "they must be of manager" in standby.notice()
    process = standby._process
    assert process is not None
    process.communicate()
