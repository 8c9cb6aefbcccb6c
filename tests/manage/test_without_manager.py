"""What is said of a robot by its agents alone."""

from __future__ import annotations

from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from poise.manage.control_socket import agents_without_manager
from poise.manage.control_socket.agents_without_manager import (
    NoManager,
    ask_agents,
    status_by_agents,
)
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    State,
)
from poise.wire.robots_here import AgentAddresses

AGENTS = AgentAddresses("r", {"main": "tcp/10.0.0.1:7447", "eye": "tcp/10.0.0.2:7447"})
LAST = ManagerId(key="b", user="ann", host="desk", pid=7, since=50.0)
EARLIER = ManagerId(key="a", user="bob", host="lab", pid=3, since=20.0)
NOW = 100.0


def agent(name: str, unmanaged: float, **components: State) -> AgentStatus:
    """Return the status of an agent that obeyed the last manager."""
    found = tuple(ComponentStatus(name=n, state=s) for n, s in components.items())
    containers = (ContainerStatus(name="one", pid=1, components=found),)
    return AgentStatus(
        computer=name,
        generation=1,
        uptime=9.0,
        cpu=1.0,
        manager=LAST,
        unmanaged=unmanaged,
        containers=containers if found else (),
    )


def test_it_has_no_manager_once_its_last_agent_misses_it() -> None:
    statuses = {"main": agent("main", 80.0, a="active"), "eye": agent("eye", 90.0)}
    found = status_by_agents(AGENTS, statuses, NOW)
    assert found is not None
    assert found.by_agents
    (only,) = found.deviations
    assert only.what.startswith("robot 'r' runs without a manager (since ")
    assert only.since == 90.0
    assert found.manager == LAST
    assert not found.not_known()


def test_a_robot_of_which_nothing_runs_is_not_there() -> None:
    assert status_by_agents(AGENTS, {}, NOW) is None
    idle = {"main": agent("main", 80.0), "eye": agent("eye", 80.0)}
    assert status_by_agents(AGENTS, idle, NOW) is None


@pytest.mark.parametrize("silent", ["eye", ""])
def test_whether_it_runs_is_not_known_while_one_is_silent(
    monkeypatch: pytest.MonkeyPatch, silent: str
) -> None:
    """The others run nothing; it was said not to run then."""
    statuses = {name: agent(name, 80.0) for name in AGENTS.endpoints.keys() - {silent}}
    reports = Mock(
        **{"reached.return_value": set(statuses), "statuses.return_value": statuses}
    )
    for name, value in (
        ("AgentReports", lambda *_: reports),
        ("open_session", Mock()),
        ("_listens", lambda _: True),
    ):
        monkeypatch.setattr(agents_without_manager, name, value)
    assert ask_agents(AGENTS) is None
    if not silent:
        assert ask_agents(AGENTS, wants_all=True) is None
        return
    why = (
        r"whether robot 'r' runs is not known: 'eye' \(10\.0\.0\.2:7447\) gave no "
        r"answer within 2 s; nothing runs on main"
    )
    with pytest.raises(NoManager, match=why):
        ask_agents(AGENTS, wants_all=True)


def test_one_whose_next_leader_starts_everything_is_there() -> None:
    eye = agent("eye", 80.0)
    waits = replace(eye, is_at_work=True, has_standbys=True)  # all ran on main
    assert status_by_agents(AGENTS, {"eye": waits}, NOW) is not None
    stopped = replace(eye, is_at_work=False, has_standbys=True)
    assert status_by_agents(AGENTS, {"eye": stopped}, NOW) is None


def test_one_that_is_managed_from_elsewhere_is_not_called_without_a_manager() -> None:
    statuses = {
        "main": agent("main", 0.0, a="active"),
        "eye": replace(agent("eye", 30.0, b="active"), manager=EARLIER),
    }
    found = status_by_agents(AGENTS, statuses, NOW)
    assert found is not None
    assert "has another manager: user ann on desk" in found.deviations[0].what
    assert "without a manager" not in found.deviations[0].what


def test_an_agent_that_gives_no_answer_leaves_its_computer_unknown() -> None:
    found = status_by_agents(AGENTS, {"main": agent("main", 80.0, a="active")}, NOW)
    assert found is not None
    assert found.not_known() == {"eye"}
    assert "the agent of 'eye' (10.0.0.2:7447) gave no answer" in (
        found.deviations[1].what
    )


def test_a_component_is_where_it_is_active_and_not_where_it_is_prepared() -> None:
    for first, second in (("active", "inactive"), ("inactive", "active")):
        statuses = {
            "main": agent("main", 80.0, a=first),  # type: ignore[arg-type]
            "eye": agent("eye", 80.0, a=second),  # type: ignore[arg-type]
        }
        found = status_by_agents(AGENTS, statuses, NOW)
        assert found is not None
        assert found.placement == {"a": "main" if first == "active" else "eye"}


def test_what_agents_know_to_be_wrong_is_said() -> None:
    health = ContainerHealth(name="one", state="restarting", since=70.0, reason="")
    main = agent("main", 80.0, a="failed")
    main = replace(main, cut_off=60.0, health=(health,))
    found = status_by_agents(AGENTS, {"main": main, "eye": agent("eye", 80.0)}, NOW)
    assert found is not None
    sentences = [each.what for each in found.deviations[1:]]
    assert sentences == [
        "movable components on 'main' are inactive: its lease has ended",
        "container 'one' on 'main' is restarting",
        "component 'a' on 'main' is failed",
    ]


def test_a_manager_that_is_silent_is_named_with_since_when_agents_miss_it() -> None:
    statuses = {"main": agent("main", 80.0, a="active"), "eye": agent("eye", 90.0)}
    found = status_by_agents(AGENTS, statuses, NOW, "process 7 is stopped")
    assert found is not None
    what = found.deviations[0].what
    assert what.startswith("process 7 is stopped (its agents have missed it since ")
