"""Who may command the agents of real computers."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.model.robot import Computer, Robot
from poise.session.keys import init_keys
from poise.session.launch.computers import real_agents
from poise.wire import credentials
from poise.wire.address import KEYS


def robot(address: str, *, insecure: bool = False) -> Robot:
    computer = Computer(name="left", capacity={"cpu": 1.0}, address=address)
    return Robot(name="hello", computers=(computer,), insecure=insecure)


@pytest.fixture(autouse=True)
def _no_keys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(KEYS, raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))


def test_with_keys_they_are_reached_by_tls() -> None:
    init_keys("hello")
    agents = real_agents(robot("10.0.0.1"))
    assert agents.endpoints == {"left": "tls/10.0.0.1:7447"}
    keys = agents.credentials()
    assert keys is not None
    assert keys.role == "manager"


def test_who_may_only_look_finds_them_to_look(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / "eve"
    init_keys("hello").issue("eve", "viewer", folder)
    monkeypatch.setenv(KEYS, str(folder))
    found = real_agents(robot("10.0.0.1"), "viewer").credentials()
    assert found is not None
    assert found.role == "viewer"
    with pytest.raises(UsageError, match="of viewer eve: they must be of manager"):
        real_agents(robot("10.0.0.1"))


def test_without_keys_who_is_reachable_is_not_commanded() -> None:
    with pytest.raises(UsageError, match="no keys for robot 'hello'") as refused:
        real_agents(robot("10.0.0.1"))
    assert "`insecure: true` in the robot file" in str(refused.value)


def test_keys_of_another_role_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    usual = tmp_path / "usual"
    authority = init_keys("hello", tmp_path / "owner")
    monkeypatch.setattr(credentials, "folders", lambda _: [usual])
    authority.issue("eve", "viewer", usual)
    with pytest.raises(UsageError, match=r"of viewer eve: they must be of manager$"):
        real_agents(robot("10.0.0.1"))
    own = authority.issue("left", "agent", usual)
    authority.issue("left", "manager", own.to_lead)
    with pytest.raises(UsageError, match=f"POISE_KEYS={own.to_lead} gives those"):
        real_agents(robot("10.0.0.1"))


@pytest.mark.parametrize(
    "reached", [robot("10.0.0.1", insecure=True), robot("127.0.0.1:7500")]
)
def test_what_is_insecure_or_on_this_computer_needs_none(reached: Robot) -> None:
    agents = real_agents(reached)
    assert agents.endpoints["left"].startswith("tcp/")
    assert agents.credentials() is None
