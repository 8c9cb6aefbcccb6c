"""What is said of a robot by its agents alone."""

from __future__ import annotations

import errno
import socket
from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from poise.manage.control_socket import agents_without_manager, control_client
from poise.manage.control_socket.agents_without_manager import (
    NoManager,
    ask_agents,
    status_by_agents,
)
from poise.manage.observe.deviations import Deviation
from poise.wire.records.request_records import ManagerId
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ContainerHealth,
    ContainerStatus,
    State,
)
from poise.wire.robots_here import AgentAddresses, path_of

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
        ("_connect_error", lambda _: None),
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


NO_SERVER = socket.gaierror(socket.EAI_AGAIN, "no name server answers")
NO_NETWORK = OSError(errno.ENETUNREACH, "no network")
NO_SUCH_NAME = socket.gaierror(socket.EAI_NONAME, "no such name")
REFUSED = ConnectionRefusedError(errno.ECONNREFUSED, "refused")


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
@pytest.mark.parametrize(
    ("error", "is_known"),
    [(NO_SERVER, False), (NO_NETWORK, False), (NO_SUCH_NAME, True), (REFUSED, True)],
)
def test_whether_it_runs_is_not_known_where_nobody_says_where_its_agents_are(
    monkeypatch: pytest.MonkeyPatch, *, scheme: str, error: OSError, is_known: bool
) -> None:
    """While the name server was silent, robots were said not to run."""
    monkeypatch.setattr(socket, "create_connection", Mock(side_effect=error))
    monkeypatch.setattr(socket, "getaddrinfo", Mock(side_effect=error))
    agents = AgentAddresses("r", {"eye": f"{scheme}/eye.local:7447"})
    if is_known:
        assert ask_agents(agents) is None
        return
    why = rf"runs is not known: .*\neye: eye\.local:7447: {error.strerror}"
    with pytest.raises(NoManager, match=why):
        ask_agents(agents)
    assert ask_agents(agents, "process 7 is stopped") is None


def test_one_whose_next_leader_starts_everything_is_there() -> None:
    eye = agent("eye", 80.0)
    waits = replace(eye, is_at_work=True, has_standbys=True)  # all ran on main
    assert status_by_agents(AGENTS, {"eye": waits}, NOW) is not None
    stopped = replace(eye, is_at_work=False, has_standbys=True)
    assert status_by_agents(AGENTS, {"eye": stopped}, NOW) is None


@pytest.mark.parametrize(
    ("waited", "endpoints", "is_over"),
    [(False, 3, False), (True, 3, True), (True, 4, False)],
)
def test_agents_end_what_no_standby_leads(
    monkeypatch: pytest.MonkeyPatch, *, waited: bool, endpoints: int, is_over: bool
) -> None:
    """`poise stop` refused while standbys could not lead; the others may have one."""
    known = {name: replace(agent(name, 80.0), has_standbys=True) for name in "ab"}
    agents = AgentAddresses("r", dict.fromkeys("abcd"[:endpoints], ""))
    deviations = (Deviation(what="no manager", computer="", since=80.0),)
    status = Mock(computers=known, deviations=deviations)
    monkeypatch.setattr(control_client, "ask_agents", lambda *_: status)
    error = control_client._no_manager(agents, waited=waited)
    assert error.left == (agents if is_over else None)


def test_a_stop_by_the_file_goes_to_the_manager_of_that_robot_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was refused while a manager lived; another robot may have the same name."""
    monkeypatch.setattr(control_client, "running_here", lambda: ["r"])
    for here in (AGENTS, AgentAddresses("r", {"eye": "tcp/127.0.0.1:7447"}), None):
        monkeypatch.setattr(control_client, "noted_of", lambda _, here=here: here)
        found = path_of("r") if here is AGENTS else AGENTS
        assert control_client._find(AGENTS) == found


def test_what_hinders_an_agent_is_told_without_a_manager() -> None:
    eye = replace(agent("eye", 80.0, a="active"), trouble="no standby can lead")
    found = status_by_agents(AGENTS, {"eye": eye}, NOW)
    assert found is not None
    assert "on 'eye' no standby can lead" in [each.what for each in found.deviations]


def test_one_that_is_managed_from_elsewhere_is_not_called_without_a_manager() -> None:
    statuses = {
        "main": agent("main", 0.0, a="active"),
        "eye": replace(agent("eye", 30.0, b="active"), manager=EARLIER),
    }
    found = status_by_agents(AGENTS, statuses, NOW)
    assert found is not None
    assert "has another manager: user ann on desk" in found.deviations[0].what
    assert "without a manager" not in found.deviations[0].what
    assert found.deviations[0].what.endswith("it takes commands on 'desk' only")
    led = {"main": replace(statuses["main"], has_standbys=True)}  # agents pass them on
    found = status_by_agents(AGENTS, led, NOW)
    assert found is not None
    assert "'desk' only, or on the robot's if that" in found.deviations[0].what


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
