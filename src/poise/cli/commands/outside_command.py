"""What comes from outside a running robot: `poise call`, `poise pub`."""

from __future__ import annotations

import math
import re
import sys
import time
from typing import Annotated, Any

import typer
import yaml

from poise.cli.commands.running_robot_command import Robot
from poise.cli.options import AsJson, print_json
from poise.errors import UsageError
from poise.runtime.connectors.tap import Plain
from poise.session.running_robots.running import connect
from poise.session.running_robots.running_component import RunningComponent
from poise.units import counted

_NAMED = re.compile(r"([A-Za-z_]\w*)=(.*)", re.DOTALL)
Port = Annotated[str, typer.Argument(metavar="COMPONENT.PORT", show_default=False)]
Limit = Annotated[
    float, typer.Option(metavar="SECONDS", help="How long to wait at most; up to 50.")
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

    poise call heater.heating heat power=0.4 --limit 5 --json
    """
    component, name = _component(port, robot)
    places, names = [], {}
    for argument in arguments or ():
        if found := _NAMED.fullmatch(argument):
            names[found[1]] = value_of(found[2])
        elif names:
            raise UsageError(f"{argument}: values without a name come first")
        else:
            places.append(value_of(argument))
    result = component.call_with(name, method, places, names, limit=limit)
    if as_json:
        print_json({"result": Plain(sys.maxsize).of(result)})
    elif result is not None:
        sys.stdout.write(_text(Plain().of(result)))


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
    sent, began = 0, time.monotonic()
    try:
        while most is None or sent < most:
            component.publish(name, value, limit=limit)
            sent += 1
            if rate is not None and sent != most:
                time.sleep(max(0.0, began + sent / rate - time.monotonic()))
    finally:
        sys.stderr.write(f"sent {counted(sent, 'message')} to {port}\n")


def _component(port: str, robot: str | None) -> tuple[RunningComponent, str]:
    component, dot, name = port.rpartition(".")
    if not (component and dot and name):
        raise UsageError(f"'{port}': give COMPONENT.PORT, as in heater.heating")
    return connect(robot).component(component), name


def value_of(text: str) -> Any:  # noqa: ANN401, YAML's
    """Return the value that a text in JSON or YAML has."""
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise UsageError(f"'{text}' is neither JSON nor YAML: {error}") from error


def _text(value: object) -> str:
    text = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n")
