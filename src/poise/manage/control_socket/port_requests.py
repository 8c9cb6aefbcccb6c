"""Brings messages and calls from outside to where their component works now."""

from __future__ import annotations

import secrets
from typing import Any

from poise.errors import RunError, UsageError
from poise.manage.agent_connections.statuses import components_of
from poise.manage.control_socket.commands import ParametersCommand, PortCommand
from poise.manage.deploy.desired import Incarnation
from poise.manage.deploy.running_components import RunningComponents
from poise.suggest import did_you_mean, listed
from poise.units import format_bytes
from poise.wire.codec import pack, unpack
from poise.wire.records.migration_records import StepsFailed
from poise.wire.records.request_records import (
    MOST_PACKED,
    PARAMETERS,
    PortAnswer,
    PortRequest,
    Refused,
)

LONGEST = 50.0
"""Nobody waits longer for an answer [s]."""
_MARGIN = 0.5
"""An answer is here so long after it was due at the latest [s]."""
_LOOK_EVERY = 0.02


def ask_port(run: RunningComponents, command: PortCommand) -> PortAnswer:
    """Return what came of a command; from any thread.

    It waits, within its limit, for a component that moves, restarts or is lost, and
    asks a second time only where it was surely not begun.

    Raises
    ------
    UsageError
        There is no such component, or the command is too large or takes too long.
    RunError
        Nobody took it within its limit, or what took it gave no answer.
    """
    _check(run, command)
    clock, name = run.clock, command.component
    until = clock.now() + command.limit
    while True:
        where, why = _place(run, name)
        if where:
            answer = _ask(run, command, where, until)
            if answer.outcome != "away":
                return answer
            why = answer.reason
        if run.is_over.is_set():
            raise RunError("the robot is being stopped")
        if clock.now() >= until:
            raise RunError(
                f"'{name}.{command.port}' was not reached within {command.limit:g} s: "
                f"{why}"
            )
        clock.sleep(_LOOK_EVERY)


def set_parameters(run: RunningComponents, command: ParametersCommand) -> PortAnswer:
    """Let a component take other parameters, or refuse; raises as `ask_port`.

    From any thread; the manager then keeps what the component took.
    """
    commands = {entry.name for entry in run.robot.components() if entry.command}
    if command.component in commands:
        raise UsageError(
            f"component '{command.component}' is a command line: it reads its "
            "parameters when it starts"
        )
    changes = unpack(command.changes, dict[str, Any])
    return ask_port(
        run,
        PortCommand(
            component=command.component,
            port=PARAMETERS,
            method="set",
            value=pack(((), changes)),
            limit=command.limit,
        ),
    )


def _check(run: RunningComponents, command: PortCommand) -> None:
    known = sorted(component.name for component in run.robot.components())
    if command.component not in known:
        guess = did_you_mean(command.component, known)
        raise UsageError(
            f"no component '{command.component}'{guess}; there are {listed(known)}"
        )
    if not 0 < command.limit <= LONGEST:
        raise UsageError(
            f"a limit of {command.limit:g} s: must be above 0 and at most {LONGEST:g} s"
        )
    if command.value.size > MOST_PACKED:
        raise UsageError(
            f"{format_bytes(command.value.size)} at once: at most "
            f"{format_bytes(MOST_PACKED)} go to a robot from outside"
        )


def _place(run: RunningComponents, name: str) -> tuple[str, str]:
    """Return where a component works, or an empty text and why it does not."""
    placed = run.placed.get(name)
    if placed is None:
        return "", f"component '{name}' does not run: no task at work needs it"
    if placed.computer in run.agents.out_of_reach():
        return "", f"computer '{placed.computer}' is out of reach"
    statuses = run.agents.statuses()
    here = {c: s for c, s in statuses.items() if c == placed.computer}
    for component in components_of(here):
        if (component.name, component.epoch) == (name, placed.epoch):
            is_active = component.state == "active"
            return placed.computer if is_active else "", f"it is {component.state}"
    return "", f"component '{name}' does not run on '{placed.computer}' yet"


def _ask(
    run: RunningComponents, command: PortCommand, computer: str, until: float
) -> PortAnswer:
    limit = max(0.0, until - run.clock.now())
    request = PortRequest(
        number=secrets.randbits(62),
        container=run.layout.container_of(
            run.placed.get(command.component)
            or Incarnation(component=command.component, computer=computer)
        ),
        component=command.component,
        port=command.port,
        method=command.method,
        value=command.value,
        limit=limit,
    )
    answer = run.agents.ask(computer, request, limit + _MARGIN)
    if isinstance(answer, PortAnswer):
        return answer
    what = "call" if command.method else "message"
    if run.clock.now() >= until:
        why = f"no answer within {command.limit:g} s; the {what} may have been taken"
        return PortAnswer(number=request.number, outcome="late", reason=why)
    why = f"computer '{computer}' gave no answer"
    if isinstance(answer, Refused | StepsFailed):
        why = answer.reason
    raise RunError(
        f"'{command.component}.{command.port}': {why}; the {what} may have been taken"
    )
