"""The parameters of a running robot: `poise param list`, `get` and `set`."""

from __future__ import annotations

import re
import sys
from typing import Annotated, Any

import typer
import yaml

from poise.cli.commands.outside_command import Limit, value_of
from poise.cli.commands.running_robot_command import Robot
from poise.cli.options import AsJson, print_json, running
from poise.errors import PoiseError, UsageError
from poise.session.running_robots.running import connect
from poise.suggest import did_you_mean, listed

_NAMED = re.compile(r"([A-Za-z_]\w*)=(.*)", re.DOTALL)
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
    found: dict[str, Any] = {}
    silent: list[str] = []
    for name in sorted(up.status().placement):
        try:
            found[name] = up.component(name).parameters()
        except PoiseError as error:
            silent.append(f"{name}: {error}")
    _show({name: values for name, values in found.items() if values}, as_json=as_json)
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
        sys.stdout.write(_text(values[name]))


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
        if (found := _NAMED.fullmatch(change)) is None:
            raise UsageError(f"'{change}': give NAME=VALUE, as in gain=0.06")
        values[found[1]] = value_of(found[2])
    up = connect(robot).component(component)
    _show(up.set_parameters(values, limit=limit), as_json=as_json)


def _show(values: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(values)
    elif values:
        sys.stdout.write(_text(values))


def _text(value: object) -> str:
    text = yaml.safe_dump(value, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n")


param_command = list_command
