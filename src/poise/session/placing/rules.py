"""Placements by a rule or from a file, to compare Poise's with."""

from __future__ import annotations

import random
from collections.abc import Collection, Mapping
from itertools import cycle
from pathlib import Path

import yaml

from poise import plan
from poise.errors import UsageError
from poise.model.robot import Robot

RULES = ("static", "round-robin", "whole-functions", "random:SEED", "FILE")
"""What may place instead of a solver. `FILE` (.yaml or .json) has
``component: computer``, or is what ``poise plan --json`` printed."""


def is_rule(name: str) -> bool:
    """Return whether a name is one of `RULES`."""
    return name in RULES[:3] or name.startswith("random:") or is_file(name)


def is_file(name: str) -> bool:
    """Return whether a rule is a file with a placement."""
    return Path(name).suffix in {".yaml", ".yml", ".json"}


def by_rule(rule: str, robot: Robot, problem: plan.Problem) -> dict[str, str]:
    """Return component -> computer as a rule has it.

    It may break limits. ``round-robin`` deals the components to the computers in turn,
    ``random:SEED`` at random, and ``whole-functions`` keeps what belongs to a function
    on one computer, the largest function first, where most CPU is left. None puts a
    component where it may not run.

    Raises
    ------
    UsageError
        The seed is no number, or the file names what is not there.
    """
    static = plan.static(robot, problem)
    names = [computer.name for computer in problem.computers]
    choices = {each.name: tuple(each.only or names) for each in problem.components}
    if rule == "static":
        return static
    if rule == "round-robin":
        turns = {each: cycle(each) for each in choices.values()}
        return {name: next(turns[choices[name]]) for name in static}
    if rule == "whole-functions":
        return _whole(problem, static, choices)
    if rule.startswith("random:"):
        chance = random.Random(_seed(rule))  # noqa: S311 - nothing secret
        return {name: chance.choice(choices[name]) for name in static}
    return _checked(rule, _read(Path(rule)), choices)


def _whole(
    problem: plan.Problem,
    wanted: Collection[str],
    choices: Mapping[str, tuple[str, ...]],
) -> dict[str, str]:
    """Return where functions go, as a person would deal them out."""
    cpu = {each.name: each.demand.get("cpu", 0.0) for each in problem.components}
    left = {c.name: c.capacity.get("cpu", 0.0) * c.speed for c in problem.computers}
    functions = [
        [name for name in each.components if name in wanted]
        for each in problem.architectures
    ]
    placement = {}
    for function in sorted(functions, key=lambda f: -sum(cpu[name] for name in f)):
        best = max(left, key=lambda computer: left[computer])
        for name in function:
            here = choices[name]
            placement[name] = best if best in here else here[0]
            left[placement[name]] -= cpu[name]
    return placement


def _seed(rule: str) -> int:
    try:
        return int(rule.removeprefix("random:"))
    except ValueError:
        raise UsageError(
            f"placement '{rule}': the seed is a whole number, as in random:7"
        ) from None


def _read(path: Path) -> Mapping[object, object]:
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"placement {path} cannot be read: {error}") from error
    if isinstance(found, dict) and isinstance(found.get("placement"), dict):
        found = found["placement"]
    if not isinstance(found, dict):
        raise UsageError(f"placement {path} is no mapping of components to computers")
    return found


def _checked(
    rule: str,
    found: Mapping[object, object],
    choices: Mapping[str, tuple[str, ...]],
) -> dict[str, str]:
    """Return the placement in a file; UsageError with all that is wrong with it.

    Whether it holds one architecture of each function is for the planner to say.
    """
    faults = []
    placement = {}
    for component, computer in found.items():
        name, where = str(component), str(computer)
        if name not in choices:
            faults.append(f"the task needs no component '{name}'")
        elif where not in choices[name]:
            here = " or ".join(choices[name])
            faults.append(f"'{name}' may not run on '{where}', only on {here}")
        placement[name] = where
    if faults:
        raise UsageError(f"placement {rule}: {'; '.join(faults)}")
    return placement
