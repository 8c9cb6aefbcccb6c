"""Reads what goes out over a connector, where that begins now."""

from __future__ import annotations

import secrets
from collections.abc import Iterator

from poise.errors import RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import Statuses
from poise.manage.control_socket.records import TapCommand
from poise.wire.records.migration import StepsFailed
from poise.wire.records.requests import Refused
from poise.wire.records.taps import Tap, TapReading

_LIMIT = 1.0
_BITS = 62


def read_tap(agents: Agents, command: TapCommand) -> TapReading:
    """Return what has gone out since the viewer asked last; from any thread.

    Raises
    ------
    UsageError
        There is no such connector, or several.
    RunError
        Its container or agent gives no answer.
    """
    connector, computer, container = begin_of(agents.statuses(), command.connector)
    asked = Tap(
        number=secrets.randbits(_BITS),
        container=container,
        connector=connector,
        viewer=command.viewer,
        rate=command.rate,
        items=command.items,
        limit=_LIMIT,
    )
    answer = agents.ask(computer, asked, _LIMIT)
    if isinstance(answer, TapReading):
        return answer
    why = f"no answer within {_LIMIT:g} s"
    if isinstance(answer, Refused | StepsFailed):
        why = answer.reason
    raise RunError(f"connector '{connector}' on '{computer}': {why}")


def begin_of(statuses: Statuses, asked: str) -> tuple[str, str, str]:
    """Return a connector's name, and the computer and container where it begins.

    Parameters
    ----------
    asked
        Its name, or ``component.port`` of an end that has one connector only, or whose
        connectors all carry the same messages.

    Raises
    ------
    UsageError
        There is no such connector, or several that differ.
    """
    found = dict(_begins(statuses))
    sources = [name for name in found if name.startswith(f"{asked}-")]
    targets = [name for name in found if name.endswith(f"-{asked}")]
    names = [asked] if asked in found else sources or targets
    if not names:
        listed = "; ".join(sorted(found)) or "none"
        raise UsageError(f"no connector '{asked}' (there are: {listed})")
    if names == targets and len(names) > 1:
        raise UsageError(f"several lead to '{asked}': {'; '.join(sorted(names))}")
    return (names[0], *found[names[0]])


def _begins(statuses: Statuses) -> Iterator[tuple[str, tuple[str, str]]]:
    for computer, status in sorted(statuses.items()):
        for container in status.containers:
            for end in container.connectors:
                if end.end != "target":
                    yield end.name, (computer, container.name)
