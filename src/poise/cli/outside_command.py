"""What comes from outside a running robot: `poise call`, `pub` and `param`."""

from __future__ import annotations

import math
import re
import sys
import time
from functools import partial
from typing import Annotated, Any

import typer

from poise.cli.main import Interrupts
from poise.cli.options import AsJson, as_yaml, parse_option, print_json, running
from poise.cli.running_robot_command import Robot
from poise.errors import (
    CalleeError,
    PoiseError,
    RunError,
    UsageError,
    did_you_mean,
    listed,
)
from poise.runtime.connectors.tap import Plain
from poise.session import sleep_until
from poise.session.running_robots.running import NoManager, connect
from poise.session.running_robots.running_component import RunningComponent, value_of
from poise.units import SECONDS, counted

_MOST_FAILURES = 10
"""`poise pub --rate` ends when more messages than these fail one after the other."""
_NAMED = re.compile(r"([A-Za-z_]\w*)=(.*)", re.DOTALL)
Port = Annotated[str, typer.Argument(metavar="COMPONENT.PORT", show_default=False)]
Limit = Annotated[
    float,
    typer.Option(
        metavar="TIME",
        parser=partial(parse_option, "--limit", dimension=SECONDS),
        help="How long to wait at most, such as 500ms or 5s; up to 50s.",
    ),
]


def call_command(
    port: Port,
    method: Annotated[str, typer.Argument(show_default=False)],
    arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VALUE | NAME=VALUE]...", help="As JSON or YAML."),
    ] = None,
    limit: Limit = 1.0,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Call a method of a component of a running robot, and print the result.

    The component may move meanwhile: the call is made once, where it then is.

    Examples
    --------
    poise call heater.heating heat 0.4

    poise call heater.heating heat power=0.4 --limit 5s --json
    """
    component, name = _component(port, robot)
    places, names = [], {}
    for argument in arguments or ():
        if named := _NAMED.fullmatch(argument):
            names[named[1]] = value_of(named[2])
        elif names:
            raise UsageError(f"{argument}: values without a name come first")
        else:
            places.append(value_of(argument))
    result = component.call_with(name, method, places, names, limit=limit)
    if as_json:
        print_json({"result": Plain(sys.maxsize).of(result)})
    elif result is not None:
        sys.stdout.write(as_yaml(Plain().of(result)))


def pub_command(
    port: Port,
    message: Annotated[str, typer.Argument(help="As JSON or YAML.")],
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", help="Send it again and again, until Ctrl-C."),
    ] = None,
    count: Annotated[
        int | None, typer.Option(min=1, help="End after so many messages.")
    ] = None,
    limit: Limit = 1.0,
    robot: Robot = None,
) -> None:
    """Send a message into a running robot.

    A topic's message goes to all who are connected to it, as if its component had
    published it; that of a port which subscribes goes to this port alone. Each goes
    out once, also while the component moves.

    Examples
    --------
    poise pub counter.count '{value: 7}'

    poise pub printer.count '{value: 7}' --rate 10 --count 50
    """
    if rate is not None and not (math.isfinite(rate) and rate > 0):
        raise UsageError(f"--rate {rate:g}: must be a positive number of messages")
    component, name = _component(port, robot)
    value = value_of(message)
    most = count or (1 if rate is None else None)
    tried = sent = in_a_row = 0
    began, why, interrupts = time.monotonic(), "", Interrupts()
    try:
        with interrupts:
            while most is None or tried < most:
                interrupts.check()
                tried += 1
                try:
                    component.publish(name, value, limit=limit)
                except NoManager:
                    raise
                except RunError as error:  # its container ended, say
                    in_a_row, why = in_a_row + 1, str(error)
                    if rate is None or in_a_row > _MOST_FAILURES:
                        raise
                else:
                    sent, in_a_row = sent + 1, 0
                if rate is not None and tried != most:
                    sleep_until(began + tried / rate, interrupts.check)
    finally:
        sys.stderr.write(f"sent {counted(sent, 'message')} to {port}\n")
        failed = f"{counted(tried - sent, 'message')} may be lost; the last: {why}"
        if interrupts.number and tried > sent:
            sys.stderr.write(f"{failed}\n")
    if tried > sent:
        raise RunError(failed)


def _component(port: str, robot: str | None) -> tuple[RunningComponent, str]:
    component, dot, name = port.rpartition(".")
    if not (component and dot and name):
        raise UsageError(f"'{port}': give COMPONENT.PORT, as in heater.heating")
    return connect(robot).component(component), name


Component = Annotated[
    str, typer.Argument(show_default=False, autocompletion=running("components"))
]


def list_command(robot: Robot = None, as_json: AsJson = False) -> None:
    """List the parameters of all components that run, as they are now.

    Examples
    --------
    poise param list
    """
    up = connect(robot)
    parameters: dict[str, Any] = {}
    silent: list[str] = []
    for name in sorted(up.status().placement):
        try:
            parameters[name] = RunningComponent(up.name, name).parameters()
        except NoManager:
            raise
        except PoiseError as error:
            silent.append(f"{name}: {error}")
    _show(
        {name: values for name, values in parameters.items() if values}, as_json=as_json
    )
    for sentence in silent:
        sys.stderr.write(f"{sentence}\n")
    if silent:
        raise typer.Exit(1)


def get_command(
    component: Component,
    name: Annotated[str, typer.Argument(help="Only this one.")] = "",
    limit: Limit = 1.0,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Print a component's parameters, or one of them.

    Examples
    --------
    poise param get controller

    poise param get controller gain
    """
    values = connect(robot).component(component).parameters(limit=limit)
    if name and name not in values:
        guess = did_you_mean(name, values)
        raise UsageError(
            f"'{component}' has no parameter '{name}'{guess}; it has {listed(values)}"
        )
    if as_json or not name:
        _show({name: values[name]} if name else values, as_json=as_json)
    else:
        sys.stdout.write(as_yaml(values[name]))


def set_command(
    component: Component,
    changes: Annotated[
        list[str],
        typer.Argument(metavar="NAME=VALUE...", help="Values as JSON or YAML."),
    ],
    limit: Limit = 1.0,
    robot: Robot = None,
    as_json: AsJson = False,
) -> None:
    """Set parameters of a component that runs: all that are given, or none.

    The component may refuse them. They hold for as long as the robot is up, wherever
    the component moves or restarts; the robot file stays as it is.

    Examples
    --------
    poise param set controller gain=0.06

    poise param set controller gain=0.06 'period=20 ms'
    """
    values = {}
    for change in changes:
        if (named := _NAMED.fullmatch(change)) is None:
            raise UsageError(f"'{change}': give NAME=VALUE, as in gain=0.06")
        values[named[1]] = value_of(named[2])
    up = connect(robot).component(component)
    try:
        taken = up.set_parameters(values, limit=limit)
    except CalleeError as error:
        refused = f"component '{component}' refused {listed(values)}: {error}"
        raise UsageError(f"{refused}; nothing was changed") from error
    _show(taken, as_json=as_json)


def _show(values: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(values)
    elif values:
        sys.stdout.write(as_yaml(values))


param_command = list_command
