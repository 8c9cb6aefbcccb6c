"""Robots that go on without a manager: found where it noted their agents.

Agents are only listened to: a robot is there if one says that it runs something.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from msgspec.structs import replace

from poise.clock import SystemClock, time_of_day, wall_time
from poise.errors import RunError
from poise.manage.agent_connections.reports import AgentReports
from poise.manage.agent_connections.statuses import Statuses, located
from poise.manage.control_socket.commands import RobotStatus
from poise.manage.observe.deviations import Deviation
from poise.wire.control_session import close_session, endpoint_of, open_session
from poise.wire.robots_here import AgentAddresses, noted

if TYPE_CHECKING:
    from poise.wire.credentials import Credentials

AGENT_LIMIT = 2.0
"""An agent that is there reports within this time [s]: it does so twice a second."""
_OTHERS_LIMIT = 0.7
"""The others report within this time after the first one [s]."""
_CONNECT_LIMIT = 0.5
_MOST_AT_ONCE = 8
_TELLS_NOTHING = (socket.EAI_AGAIN, errno.ENETUNREACH)
"""With these errors it is this computer that reaches no name server, or no network."""


class NoManager(RunError):
    """A robot is there, but no manager of it answers on this computer."""

    exit_code = 4

    def __init__(
        self,
        message: str,
        status: RobotStatus | None,  # what its agents say; None: they are not known
        left: AgentAddresses | None = None,  # where they are, if its manager is gone
    ) -> None:
        super().__init__(message)
        self.status = status
        self.left = left


def robots_without_manager(but: Collection[str] = ()) -> dict[str, RobotStatus]:
    """Return the robots that go on without a manager that this computer had."""
    left = [addresses for addresses in noted() if addresses.robot not in but]
    with ThreadPoolExecutor(_MOST_AT_ONCE) as pool:
        found = list(pool.map(_answer, left))
    return {status.robot: status for status in found if status is not None}


def _answer(addresses: AgentAddresses) -> RobotStatus | None:
    try:
        return ask_agents(addresses)
    except NoManager:
        return None


def ask_agents(
    addresses: AgentAddresses, why: str = "", *, wants_all: bool = False
) -> RobotStatus | None:
    """Return what the agents of a robot say; None: none says that something runs.

    `why`: why the manager does not answer, and the way out; empty: it is gone.
    `wants_all`: that some run nothing is no answer while others are silent.
    NoManager: it is not known whether the robot runs: something listens where its
    agents are, and none answers, or, with `wants_all`, not all do; or nobody says where
    they are, or this computer has no network.
    """
    with ThreadPoolExecutor(_MOST_AT_ONCE) as pool:
        errors = list(pool.map(_connect_error, addresses.endpoints.values()))
    if all(errors):
        if not why:
            _raise_if_nothing_told(addresses, errors)
        return None
    endpoints, keys = addresses.endpoints, addresses.credentials()
    reports = AgentReports(addresses.robot, endpoints, SystemClock())
    session = open_session(connect=tuple(endpoints.values()), keys=keys)
    try:
        kept = reports.subscribe(session)
        reports.wait_news(lambda: bool(reports.reached()), AGENT_LIMIT)
        reports.wait_news(lambda: reports.reached() == endpoints.keys(), _OTHERS_LIMIT)
        del kept
    finally:
        close_session(session)
    reached = reports.reached()
    if not reached and not why:
        _raise_if_refused(addresses, keys)
    found = status_by_agents(addresses, reports.statuses(), wall_time(), why)
    if found is None and wants_all and reached and reached != endpoints.keys():
        silent = sorted(endpoints.keys() - reached)
        where = [f"'{name}' ({endpoint_of(endpoints[name])})" for name in silent]
        raise _not_known(
            addresses,
            f"{', '.join(where)} gave no answer within {AGENT_LIMIT:g} s; nothing runs "
            f"on {', '.join(sorted(reached))}",
        )
    return found and replace(found, ages=reports.ages())


def _not_known(addresses: AgentAddresses, why: str) -> NoManager:
    text = f"whether robot '{addresses.robot}' runs is not known: {why}"
    return NoManager(text, status=None)


def _raise_if_nothing_told(
    addresses: AgentAddresses, errors: Sequence[OSError | None]
) -> None:
    places = zip(addresses.endpoints.items(), errors, strict=True)
    each = "".join(
        f"\n{name}: {endpoint_of(locator)}: {error.strerror}"
        for (name, locator), error in places
        if error is not None and error.errno in _TELLS_NOTHING
    )
    if each:
        why = f"this computer does not reach its agents{each}"
        raise _not_known(addresses, why)


def _raise_if_refused(addresses: AgentAddresses, keys: Credentials | None) -> None:
    from poise.wire.refusal import why_all_refused  # noqa: PLC0415, `ssl` is slow

    agents = {name: endpoint_of(e) for name, e in addresses.endpoints.items()}
    if reasons := why_all_refused(agents, keys, if_not_there=False):
        each = "".join(
            f"\n{name}: {why or 'its agent gives no answer'}"
            for name, why in sorted(reasons.items())
        )
        raise _not_known(addresses, f"none of its agents answers{each}")


def status_by_agents(
    addresses: AgentAddresses, statuses: Statuses, now: float, why: str = ""
) -> RobotStatus | None:
    """Return what is known of a robot by its agents alone; see `ask_agents`. Pure.

    `now`: when they were asked [s since 1970].
    """
    managers = [s.manager for s in statuses.values() if s.manager is not None]
    agents = statuses.values()
    runs = any(s.containers or (s.has_standbys and s.is_at_work) for s in agents)
    if not managers or not runs:
        return None
    # of agents that were out of the last manager's reach, an earlier one
    manager = max(managers, key=lambda other: other.since)
    since = [status.unmanaged for status in statuses.values()]
    is_gone = all(since)
    robot = addresses.robot
    if why:
        missed = f" (its agents have missed it since {time_of_day(max(since))})"
        why += missed if is_gone else ""
    elif is_gone:
        began = time_of_day(max(since))
        why = (
            f"robot '{robot}' runs without a manager (since {began}); `poise up FILE` "
            "takes it over, `poise stop` ends it"
        )
    else:
        passed_on = any(status.has_standbys for status in agents)
        others = ", or on the robot's if that is one of them" if passed_on else ""
        why = (
            f"robot '{robot}' has another manager: {manager}; it takes commands on "
            f"'{manager.host}' only{others}"
        )
    first = Deviation(what=why, computer="", since=max(since) if is_gone else now)
    silent = sorted(addresses.endpoints.keys() - statuses.keys())
    return RobotStatus(
        robot=robot,
        task="",
        manager=manager,
        placement=_placement(statuses),
        computers=statuses,
        out_of_reach=dict.fromkeys(silent, now),
        deviations=(first, *_deviations(addresses.endpoints, silent, statuses, now)),
        by_agents=True,
    )


def _deviations(
    endpoints: Mapping[str, str],
    silent: Collection[str],
    statuses: Statuses,
    now: float,
) -> Iterator[Deviation]:
    """Yield what is wrong beside the manager, as far as agents know."""
    for name in silent:
        what = (
            f"the agent of '{name}' ({endpoint_of(endpoints[name])}) gave no answer "
            f"within {AGENT_LIMIT:g} s: its components are not known"
        )
        yield Deviation(what=what, computer=name, since=now)
    for name, status in sorted(statuses.items()):
        if status.trouble:
            what = f"on '{name}' {status.trouble}"
            yield Deviation(what=what, computer=name, since=now)
        if status.cut_off:
            what = f"movable components on '{name}' are inactive: its lease has ended"
            yield Deviation(what=what, computer=name, since=status.cut_off)
        for health in status.health:
            if health.state not in {"running", "stopped"}:
                what = f"container '{health.name}' on '{name}' is {health.state}"
                what += f": {health.reason}" if health.reason else ""
                yield Deviation(
                    what=what, computer=name, container=health.name, since=health.since
                )
    for name, component in located(statuses):
        if component.state in {"failed", "unresponsive"}:
            own = component.name
            what = f"component '{own}' on '{name}' is {component.state}"
            yield Deviation(what=what, computer=name, component=own, since=now)


def _placement(statuses: Statuses) -> dict[str, str]:
    """Return where components are; of several incarnations, where one is active."""
    active = {c.name: name for name, c in located(statuses) if c.state == "active"}
    return {c.name: name for name, c in located(statuses)} | active


def _connect_error(locator: str) -> OSError | None:
    """Return why nothing listens there; None: something may.

    TLS servers log those who only connect: only their names are looked up.
    """
    at = endpoint_of(locator)
    try:
        if locator.startswith("tls/"):
            socket.getaddrinfo(at.host, at.port)
        else:
            socket.create_connection((at.host, at.port), _CONNECT_LIMIT).close()
    except OSError as error:
        return error
    return None
