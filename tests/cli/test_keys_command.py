"""`poise keys`: names that lead elsewhere, and keys that are damaged."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest

from poise.cli.agent_command import keys_for
from poise.errors import UsageError
from poise.session.keys import authority_of
from tests.command import run_poise


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make an authority of robot `hello` in a folder of this test."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert run_poise("keys", "init", "hello").returncode == 0
    return tmp_path / "data/poise/keys"


@pytest.mark.parametrize("name", ["../right", "..", "", " "])
def test_keys_are_issued_below_the_folder_that_is_named(
    name: str, tmp_path: Path
) -> None:
    out = tmp_path / "out/keys"
    done = run_poise("keys", "issue", "hello", "left", name, "--out", out)
    assert done.returncode == 2
    assert f"'{name}' is no name" in done.stderr
    assert not out.parent.exists()


def test_a_computer_has_a_name_that_a_robot_file_may_have(tmp_path: Path) -> None:
    asked, out = ("keys", "issue", "hello"), ("--out", tmp_path / "out")
    done = run_poise(*asked, "left", "arm.2", *out)
    assert done.returncode == 2
    assert "'arm.2' is not a computer's name: a letter of a-z" in done.stderr
    assert not (tmp_path / "out").exists()
    people = (*out, "--role", "viewer")
    done = run_poise(*asked, "arm.2", *people)
    assert done.returncode == 0
    assert "its person" in done.stdout
    assert not {"agent", "--keys"} & {*done.stdout.replace("`", " ").split()}
    done = run_poise(*asked, "\udcff", *people)  # on the command line, no UTF-8
    assert done.returncode == 2
    assert "is no name" in done.stderr


def test_who_may_only_look_gets_no_keys_to_lead_the_robot(tmp_path: Path) -> None:
    asked = ("keys", "issue", "hello", "kim", "--role", "viewer", "--leads")
    done = run_poise(*asked, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "--leads is for computers, not with --role viewer" in done.stderr
    assert not (tmp_path / "out").exists()


def test_no_agent_starts_with_the_keys_of_another_computer(tmp_path: Path) -> None:
    """All seemed well, and what was said about its keys named the other computer."""
    run_poise("keys", "issue", "hello", "left", "right", "--out", tmp_path)
    left, right = tmp_path / "left", tmp_path / "right"
    its = "hello", "left", "127.0.0.1"
    assert keys_for(*its, left, is_insecure=False) == str(left)
    why = "are of agent right, not of agent left: `poise keys issue hello left`"
    with pytest.raises(UsageError, match=why):
        keys_for(*its, right, is_insecure=False)


def test_an_agent_does_not_drop_the_keys_that_it_is_given(tmp_path: Path) -> None:
    its = "hello", "left", "127.0.0.1"
    with pytest.raises(UsageError, match="--keys and --insecure: give one of the two"):
        keys_for(*its, tmp_path, is_insecure=True)
    assert not keys_for(*its, None, is_insecure=True)


def test_keys_to_lead_with_are_listed_and_renewed(tmp_path: Path) -> None:
    """They ended, as `issue` renewed the others alone, and `list` was content."""
    asked = ("keys", "issue", "hello", "left", "--out", tmp_path)
    run_poise(*asked, "--leads", "--days", "5")
    listed = ("keys", "list", "--folder", tmp_path / "left")
    done = run_poise(*listed)
    assert done.returncode == 1
    assert "the certificate of manager left ends in 5.0 days" in done.stderr
    assert "agent left, also to lead the robot, until" in run_poise(*asked).stdout
    assert run_poise(*listed).returncode == 0


def test_the_keys_of_the_owner_are_renewed_with_the_others(
    data: Path, tmp_path: Path
) -> None:
    """`keys issue` was said to renew them, and no way to call it did."""
    authority_of("hello").issue("owner", "manager", data / "hello", days=3)
    assert run_poise("keys", "list", "hello").returncode == 1
    issue = ("keys", "issue", "hello", "left", "--out", tmp_path / "out")
    assert f"{data / 'hello'}: manager owner, until" in run_poise(*issue).stdout
    assert run_poise("keys", "list", "hello").returncode == 0
    assert "manager owner" not in run_poise(*issue).stdout


def test_a_folder_that_is_not_there_has_no_keys(tmp_path: Path) -> None:
    done = run_poise("keys", "list", "--folder", tmp_path / "nowhere")
    assert done.returncode == 2
    assert "there is no such folder" in done.stderr


@pytest.mark.parametrize("days", ["nan", "inf", "1e9"])
def test_keys_do_not_outlive_their_authority(days: str, tmp_path: Path) -> None:
    options = ["--days", days, "--out", tmp_path / "out"]
    done = run_poise("keys", "issue", "hello", "left", *options)
    assert done.returncode == 2
    assert "it is 3650 at most" in done.stderr


def test_keys_that_end_with_their_authority_say_what_to_do(tmp_path: Path) -> None:
    options = ["--days", "3650", "--out", tmp_path / "out"]
    done = run_poise("keys", "issue", "hello", "left", *options)
    assert "the authority ends then, too: `poise keys rotate hello`" in done.stdout


def test_the_old_authority_is_said_to_be_accepted_until_it_is_forgotten() -> None:
    """After two of three steps, lost keys seemed locked out, and were not."""
    said = [run_poise("keys", "rotate", "hello").stdout for _ in range(3)]
    assert "is known; it signs after the next `rotate`" in said[0]
    assert "what the one before signed is accepted until the next" in said[1]
    assert "any before the present one is forgotten" in said[2]


def test_damaged_keys_do_not_hide_the_others(data: Path) -> None:
    (data / "damaged").mkdir()
    done = run_poise("keys", "list", "--json")
    assert done.returncode == 1
    assert [each["robot"] for each in json.loads(done.stdout)] == ["hello"]
    assert f"{data / 'damaged'} lacks authority.pem" in done.stderr


def test_keys_of_another_user_do_not_hide_the_others(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs, is_file = data / "theirs", Path.is_file

    def is_file_as_other_user(path: Path) -> bool:
        if path.parent == theirs:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return is_file(path)

    theirs.mkdir()
    monkeypatch.setattr(Path, "is_file", is_file_as_other_user)
    done = run_poise("keys", "list", "--json")
    assert done.returncode == 1
    assert [each["robot"] for each in json.loads(done.stdout)] == ["hello"]
    assert f"{theirs} cannot be read: Permission denied" in done.stderr
