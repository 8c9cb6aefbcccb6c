"""Checks what a robot file refers to: modules, programs and parameters."""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

from poise.errors import did_you_mean, listed
from poise.model.check.names import components
from poise.model.robot import Architecture, ComponentEntry, Robot
from poise.model.yaml_tree import Finding
from poise.model.yaml_tree import Path as Place
from poise.runtime.component.component import Component
from poise.runtime.component.parameters import parameters_type, problems
from poise.runtime.hosting.command_line import runnable


def check_origin(
    path: Place, architecture: Architecture, module: str
) -> Iterator[Finding]:
    """Yield a module of the repository that another of the same name hides."""
    if not architecture.file:
        return
    folder = Path(architecture.file).parent
    top = module.partition(".")[0]
    beside = next((p for p in (folder / top, folder / f"{top}.py") if p.exists()), None)
    used = sys.modules[module].__file__
    if beside and used and not Path(used).resolve().is_relative_to(folder):
        yield Finding(
            (*path, "implementation"),
            f"module '{module}' is {used}, so {beside} would never run: Python knows "
            "one module of a name. Rename one of them, or put it into a package",
        )


def check_programs(robot: Robot) -> Iterator[Finding]:
    """Yield the commands that are not on this machine, which emulates all computers."""
    if any(computer.address is not None for computer in robot.computers):
        return  # their programs are there
    for path, _, component in components(robot):
        try:
            if component.command:
                runnable(component.command, robot.folder)
        except OSError as error:
            text = f"component '{component.name}': '{component.command[0]}': {error}"
            yield Finding((*path, "ros2" if component.ros2 else "command"), text)


def check_parameters(
    path: Place, entry: ComponentEntry, code: type[Component]
) -> Iterator[Finding]:
    """Yield the parameters that no code of a component reads, or do not fit it."""
    if (type_ := parameters_type(code)) is not None:
        for name, text in problems(type_, entry.parameters):
            place = (*path, "parameters", name) if name else path
            yield Finding(place, f"'{entry.implementation}': {text}")
        return
    if not entry.parameters or (known := _read_by(code)) is None:
        return
    for name in entry.parameters:
        if name not in known:
            yield Finding(
                (*path, "parameters", name),
                f"'{entry.implementation}' reads no parameter '{name}'"
                f"{did_you_mean(name, known)}; it reads {listed(known)}",
            )


def _read_by(code: type[Component]) -> list[str] | None:
    """Return the parameters that a class reads by name; None: it may read others."""
    names: list[str] = []
    for base in code.__mro__[: code.__mro__.index(Component)]:
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
        except (OSError, TypeError, SyntaxError):
            return None
        read = list(_reads(tree))
        if len(read) < sum(map(_may_read, ast.walk(tree))):
            return None
        names += read
    return sorted({*names})


def _may_read(node: ast.AST) -> bool:
    """Whether parameters are named, or the component is given to other code."""
    if isinstance(node, ast.Call):
        given = (*node.args, *(keyword.value for keyword in node.keywords))
        return any(isinstance(arg, ast.Name) and arg.id == "self" for arg in given)
    return _is_parameters(node) or (
        isinstance(node, ast.Attribute) and node.attr == "_context"
    )


def _reads(tree: ast.AST) -> Iterator[str]:
    """Yield each name by which parameters are read."""
    for node in ast.walk(tree):
        match node:
            case (
                ast.Subscript(value=value, slice=ast.Constant(value=str(name)))
                | ast.Call(
                    func=ast.Attribute(value=value, attr="get"),
                    args=[ast.Constant(value=str(name)), *_],
                )
                | ast.Compare(
                    left=ast.Constant(value=str(name)),
                    ops=[ast.In() | ast.NotIn()],
                    comparators=[value],
                )
            ) if _is_parameters(value):
                yield name


def _is_parameters(node: ast.AST) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "parameters"
