"""A robot's authority, and the keys that it makes."""

from __future__ import annotations

import re
import stat
from pathlib import Path
from unittest.mock import Mock

import pytest

from poise.clock import wall_time
from poise.errors import RunError, UsageError
from poise.session.keys import Authority, authority_of, init_keys
from poise.wire import credentials
from poise.wire.address import KEYS
from poise.wire.credentials import (
    AUTHORITY,
    CERTIFICATE,
    HEARTBEATS,
    PRIVATE_KEY,
    Credentials,
    RenewableKeys,
    find,
    minute,
)

DAY = 86400.0


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return init_keys("hello", tmp_path / "owner")


def issue(authority: Authority, name: str = "left", days: float = 90) -> Credentials:
    folder = authority.folder.parent / name
    return authority.issue(name, "agent", folder, days=days)


def test_keys_say_of_whom_they_are_and_until_when(authority: Authority) -> None:
    keys = issue(authority, days=3)
    assert (keys.robot, keys.role, keys.name) == ("hello", "agent", "agent left")
    assert keys.expires == pytest.approx(wall_time() + 3 * DAY, abs=60)
    assert "ends in 3.0 days: `poise keys issue` renews it" in keys.warning()
    assert not issue(authority).warning()
    soon = issue(authority, days=0.03)
    assert f"ends at {minute(soon.expires)}" in soon.warning()


def test_a_process_that_goes_on_gets_renewed_keys(authority: Authority) -> None:
    """Containers that their next agent adopts had only those of their start."""
    own = RenewableKeys(issue(authority).folder)
    before = own.latest()
    assert own.latest() is before
    renewed = issue(authority, days=180)
    assert own.latest() is not before
    assert own.latest().expires == renewed.expires


def test_a_process_says_that_its_keys_have_ended_until_they_are_renewed(
    authority: Authority,
) -> None:
    """The manager said only that all computers accept no connection."""
    own = RenewableKeys(issue(authority, days=3).folder)
    assert not own.trouble
    assert own.latest().warning()
    ended = RenewableKeys(issue(authority, days=-0.01).folder)
    assert "the certificate of agent left has ended" in ended.trouble
    issue(authority)
    assert not ended.trouble


def test_keys_that_are_no_good_renew_nothing(
    authority: Authority, tmp_path: Path
) -> None:
    own = RenewableKeys(issue(authority).folder)
    before = own.latest()
    other = init_keys("other", tmp_path / "other")
    other.issue("left", "agent", before.folder)  # another robot's
    assert own.latest() is before
    (before.folder / CERTIFICATE).write_text("a part of it")
    assert own.latest() is before
    (before.folder / PRIVATE_KEY).unlink()
    assert own.latest() is before
    issue(authority)
    assert own.latest() is not before


def test_heartbeats_are_heard_throughout_a_rotation(authority: Authority) -> None:
    """A manager that went on heard none of agents that had the next keys."""
    manager = Credentials(authority.folder)
    left = issue(authority)
    for _ in range(6):
        assert manager.verified(left.sign(b"beat")) == b"beat"
        authority.rotate()
        authority.issue("owner", "manager", authority.folder)
        left = issue(authority)
        assert manager.verified(b"that somebody else has sent") is None
        assert manager.verified(left.sign(b"beat")) == b"beat"
        assert left.verified(manager.sign(b"beat")) == b"beat"
    (authority.folder / HEARTBEATS).write_text("a part of it")
    assert manager.verified(b"of somebody else") is None
    assert manager.verified(left.sign(b"beat")) == b"beat"


def test_keys_end_with_their_authority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.session.keys.MOST_DAYS", 90.5)
    authority = init_keys("hello", tmp_path / "owner")
    assert issue(authority, days=91).expires == authority.ends.timestamp()


def test_the_owner_may_command(authority: Authority) -> None:
    assert Credentials(authority.folder).check("hello", "manager").name == (
        "manager owner"
    )


def test_nobody_else_can_read_them(authority: Authority) -> None:
    folders = [authority.folder, authority.folder / "owner", issue(authority).folder]
    for folder in folders:
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        files = [path for path in folder.iterdir() if path.is_file()]
        assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in files)


def test_keys_that_others_can_read_are_refused(authority: Authority) -> None:
    key = issue(authority).folder / credentials.PRIVATE_KEY
    key.chmod(0o640)
    with pytest.raises(UsageError, match=r"key\.pem can be read by others: chmod 600"):
        Credentials(key.parent)


@pytest.mark.parametrize("name", [*credentials.FILES, HEARTBEATS])
def test_it_says_what_is_missing(authority: Authority, name: str) -> None:
    folder = issue(authority).folder
    (folder / name).unlink()
    with pytest.raises(UsageError, match=f"lacks {name}: `poise keys issue`"):
        Credentials(folder).check("hello", "agent")


def test_who_may_only_look_can_forge_no_heartbeat(authority: Authority) -> None:
    folder = authority.folder.parent / "eve"
    eve = authority.issue("eve", "viewer", folder).check("hello", "viewer")
    assert not (eve.folder / HEARTBEATS).exists()
    authority.issue("eve", "agent", folder)
    authority.issue("eve", "manager", eve.to_lead)
    authority.issue("eve", "viewer", folder)  # nothing of before is left
    assert {path.name for path in folder.iterdir()} == {*credentials.FILES}
    assert eve.verified(issue(authority).sign(b"beat")) is None


def test_damaged_keys_are_refused(authority: Authority) -> None:
    keys = issue(authority)
    (keys.folder / HEARTBEATS).write_text("nonsense")
    with pytest.raises(RunError, match=r"heartbeats\.key is damaged"):
        Credentials(keys.folder).sign(b"beat")
    (keys.folder / credentials.CERTIFICATE).write_text("nonsense")
    with pytest.raises(RunError, match=r"certificate\.pem is no certificate"):
        Credentials(keys.folder).check("hello", "agent")


@pytest.mark.parametrize("name", [credentials.AUTHORITY, credentials.PRIVATE_KEY])
def test_keys_that_were_cut_short_are_refused(authority: Authority, name: str) -> None:
    keys = issue(authority)
    (keys.folder / name).write_bytes((keys.folder / name).read_bytes()[:100])
    with pytest.raises(RunError, match="left are unusable: "):
        Credentials(keys.folder).check("hello", "agent")


def test_keys_that_this_user_cannot_read_are_named(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = issue(authority).folder
    monkeypatch.setattr(Path, "open", Mock(side_effect=PermissionError))
    why = r"authority\.pem cannot be read by this user: chown it"
    with pytest.raises(UsageError, match=why):
        Credentials(folder)


def test_keys_of_another_robot_or_role_are_refused(authority: Authority) -> None:
    keys = issue(authority)
    with pytest.raises(UsageError, match="are robot 'hello's, not 'other's"):
        keys.check("other", "agent")
    with pytest.raises(UsageError, match="are of agent left: they must be of manager"):
        keys.check("hello", "manager")


def test_keys_that_have_ended_are_refused(authority: Authority) -> None:
    keys = issue(authority, days=-0.01)
    with pytest.raises(UsageError, match="of agent left has ended"):
        keys.check("hello", "agent")


def test_keys_before_their_time_say_that_the_clock_is_wrong(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = issue(authority)
    leads = authority.issue("me", "manager", authority.folder.parent / "me")
    monkeypatch.setattr("poise.wire.credentials.wall_time", lambda: 0.0)
    assert re.search(
        r"of agent left holds from 20\S+ \S+ UTC on, and it is 1970-01-01 00:00 UTC by "
        "this computer's clock: set the clock",
        keys.warning(),
    )
    assert keys.check("hello", "agent") is keys  # its clock may be set in a moment
    with pytest.raises(UsageError, match="set the clock"):
        leads.check("hello", "manager")


def test_there_is_one_authority(authority: Authority) -> None:
    with pytest.raises(UsageError, match="has an authority in"):
        init_keys("hello", authority.folder)


def test_without_an_authority_nothing_is_issued(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"is not here .* `poise keys init`"):
        authority_of("hello", tmp_path)


@pytest.mark.parametrize("name", ["current.pem", "current.key"])
def test_a_damaged_authority_issues_nothing(authority: Authority, name: str) -> None:
    (authority.folder / "owner" / name).write_text("nonsense")
    with pytest.raises(UsageError, match=rf"{name} is damaged: .*`poise keys init`"):
        issue(authority_of("hello", authority.folder))


def test_the_authority_of_another_robot_is_refused(authority: Authority) -> None:
    with pytest.raises(UsageError, match="is robot 'hello's, not 'other's"):
        authority_of("other", authority.folder)


def test_issuing_again_replaces_all(authority: Authority) -> None:
    before = issue(authority)
    (before.folder / AUTHORITY).write_text("nonsense")
    assert issue(authority).client is not None


def test_heartbeats_are_taken_from_who_has_the_key(
    authority: Authority, tmp_path: Path
) -> None:
    left, right = issue(authority), issue(authority, "right")
    other = issue(init_keys("hello", tmp_path / "forger" / "owner"))
    signed = left.sign(b"beat")
    assert right.verified(signed) == b"beat"
    assert other.verified(signed) is None
    assert right.verified(signed[:-1]) is None
    assert right.verified(b"") is None
    assert right.verified(b"beat") is None


def test_an_authority_is_replaced_while_all_know_each_other(
    authority: Authority,
) -> None:
    """Computers get theirs at different times; what got none twice is locked out."""
    oldest = issue(authority, "oldest")
    assert not authority.rotate()  # the next one is known
    old = issue(authority, "old")
    assert authority.rotate()  # it signs
    new = issue(authority, "new")
    assert old.verified(new.sign(b"beat")) == b"beat"
    assert new.verified(old.sign(b"beat")) == b"beat"
    assert oldest.verified(new.sign(b"beat")) is None
    assert not authority.rotate()
    newest = issue(authority, "newest")
    assert newest.verified(old.sign(b"beat")) is None


def test_a_step_of_a_rotation_that_was_cut_short_is_taken_again(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    authority.rotate()
    old = issue(authority, "old")
    replace = Path.replace

    def cut_short(source: Path, target: Path) -> None:
        if target.name == "current.pem":
            raise OSError("no more power")
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", cut_short)
        with pytest.raises(UsageError, match="cannot be written: no more power"):
            authority.rotate()
    assert not list(authority.folder.rglob("*.draft"))
    assert authority_of("hello", authority.folder).rotate()
    assert issue(authority, "new").verified(old.sign(b"beat")) == b"beat"


@pytest.mark.parametrize("name", ["", "..", "a/b", "a b", "a" * 64])
def test_who_has_no_name_of_a_robot_gets_no_authority(
    name: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="is not a robot's name: a letter of a-z"):
        init_keys(name, tmp_path / "owner")
    assert not list(tmp_path.iterdir())


def test_keys_are_found_by_role(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(KEYS, raising=False)
    monkeypatch.setattr(
        credentials, "folders", lambda _: [authority.folder, issue(authority).folder]
    )
    agent, manager = find("hello", "agent"), find("hello", "manager")
    assert agent is not None
    assert agent.name == "agent left"
    assert manager is not None
    assert manager.name == "manager owner"
    assert find("hello", "viewer") is None


def test_keys_that_the_environment_names_must_fit(
    authority: Authority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEYS, str(authority.folder))
    assert find("hello", "manager") is not None
    with pytest.raises(UsageError, match="they must be of agent"):
        find("hello", "agent")
