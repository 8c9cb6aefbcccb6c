"""Which faults a simulation has: from a file, from the seed, or as they are given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
from msgspec import Struct

from poise.decoding import convert
from poise.errors import FileProblem, RobotError, UsageError, unknown
from poise.model.file_keys import Name, Seconds, Share, says
from poise.model.robot import Robot
from poise.model.yaml_tree import Finding, Node, Positions, read_file
from poise.model.yaml_tree import Path as KeyPath
from poise.model.yaml_validation import validate
from poise.session.arguments import check_type
from poise.simulation.choices import Choices
from poise.simulation.faults import (
    ANYWHERE,
    KINDS,
    LINK_KINDS,
    TIMELESS,
    SimulatedFault,
    SimulatedFaultKind,
    plan_faults,
)


def fault_findings(
    fault: SimulatedFault, robot: Robot, seconds: float
) -> Iterator[tuple[str, str]]:
    """Yield the wrong fields of a fault, and what is wrong with each."""
    names = [each.name for each in robot.computers]
    if fault.kind not in KINDS:
        yield "kind", unknown("fault", fault.kind, KINDS)
    if not (isfinite(fault.at) and fault.at >= 0):
        yield "at", f"begins at {fault.at:g} s, before the robot is up"
    elif fault.at >= seconds:
        yield "at", f"begins at {fault.at:g} s, but {seconds:g} s are simulated"
    if not (isfinite(fault.lasts) and fault.lasts > 0):
        yield "lasts", f"lasts {fault.lasts:g} s; a fault must last longer than 0 s"
    if not 0 <= fault.pick < 1:
        yield "pick", f"picks {fault.pick:g}, which is not in [0, 1)"
    if fault.target not in names:
        yield "target", unknown("computer", fault.target, names)
    yield from _other(fault, names)


def _other(fault: SimulatedFault, names: list[str]) -> Iterator[tuple[str, str]]:
    if fault.kind not in LINK_KINDS:
        if fault.other:
            yield "other", f"'{fault.kind}' is about one computer"
    elif fault.other not in names:
        yield "other", unknown("computer", fault.other, names)
    elif fault.other == fault.target:
        yield "other", f"a link is between two computers, not from '{fault.other}' back"


Faults: TypeAlias = Sequence[SimulatedFault] | str | PathLike[str]
"""Faults, the file that they are in, or `RANDOM`."""
RANDOM = "random"
_LONGEST_PAUSE, _FEWEST = 300.0, 6
"""The seed picks a fault every five minutes, or about six in a short simulation."""
_AT_ONCE = 1.0
"""What a fault without `for` has instead [s]."""
_KEYS: Mapping[str, KeyPath] = {"target": ("computer",), "lasts": ("for",)}


class FaultKeys(Struct, frozen=True, kw_only=True):
    """Something that breaks, and is whole again a while later."""

    at: Annotated[
        Seconds, says("When it begins, counted from when the robot is up: 10 min.")
    ]
    fault: Annotated[SimulatedFaultKind, says("What breaks.")]
    computer: Annotated[Name | None, says("Where.")] = None
    between: Annotated[
        tuple[Name, Name] | None,
        says(
            "Of links: two computers; `cut one way` cuts from the first to the other."
        ),
    ] = None
    lasts: Annotated[
        Seconds | None, says("How long it lasts: 30 s.", key="for", gt=0)
    ] = None
    pick: Annotated[
        Share,
        says(
            "Which of several containers, how many datagrams are lost, or how far a "
            "clock steps: from 0, the first or the least, to below 1.",
            lt=1,
        ),
    ] = 0.0


class DocumentKeys(Struct, frozen=True):
    """A file with faults."""

    faults: Annotated[tuple[FaultKeys, ...], says("What breaks, in any order.")]


def faults_of(
    robot: Robot, faults: Faults, seconds: float, seed: int
) -> tuple[SimulatedFault, ...]:
    """Return the faults of a simulation of `seconds` [virtual s]."""
    if isinstance(faults, str) and faults == RANDOM:
        return _random(robot, seconds, seed)
    if isinstance(faults, str | PathLike):
        return read_faults(Path(faults), robot, seconds)
    is_what = f"a list of `SimulatedFault`, a file, or '{RANDOM}'"
    check_type("faults", faults, Sequence, is_what)
    for number, fault in enumerate(faults):
        check_type(f"faults[{number}]", fault, SimulatedFault, "a `SimulatedFault`")
    findings = [
        f"{fault}: {message}"
        for fault in faults
        for _, message in fault_findings(fault, robot, seconds)
    ]
    if findings:
        raise UsageError("; ".join(findings))
    return tuple(faults)


def read_faults(path: Path, robot: Robot, seconds: float) -> tuple[SimulatedFault, ...]:
    """Return the faults in a file."""
    problems: list[FileProblem] = []
    root = read_file(path, None, problems)
    if root is None:
        raise RobotError(problems=problems)
    validate(root, msgspec.inspect.type_info(DocumentKeys), problems)
    positions = Positions(root)
    faults = []
    for number, node in enumerate(_entries(root)):
        found = validate(node, msgspec.inspect.type_info(FaultKeys), [])
        if found is None:  # why is among the file's problems
            continue
        keys = convert(found, FaultKeys)
        findings = list(_shape(keys, node))
        refused = {key for path, _ in findings for key in path}
        findings += [
            (path, message)
            for path, message in _findings(keys, robot, seconds)
            if path[0] not in refused
        ]
        problems += [
            positions.problem(Finding(("faults", number, *path), message))
            for path, message in findings
        ]
        if not findings:
            faults.append(_fault(keys, robot))
    if problems:
        raise RobotError(problems=sorted(problems))
    return tuple(faults)


def _entries(root: Node) -> list[Node]:
    listed = root.value.get("faults") if isinstance(root.value, dict) else None
    return listed.value if listed and isinstance(listed.value, list) else []


def _shape(keys: FaultKeys, node: Node) -> Iterator[tuple[KeyPath, str]]:
    """Yield the keys that a kind of fault lacks, or does not take."""
    kind = keys.fault
    written = node.value if isinstance(node.value, dict) else {}
    wanted = "between" if kind in LINK_KINDS else "computer"
    given = {"computer": keys.computer, "between": keys.between}
    for key, example in (("between", "[main, vision]"), ("computer", "main")):
        is_wanted = key == wanted and kind not in ANYWHERE
        if is_wanted and key not in written:
            yield (), f"'{kind}' lacks the key '{key}': write `{key}: {example}`"
        if not is_wanted and given[key] is not None:
            yield (key,), f"'{kind}' takes no '{key}'"
    if kind in TIMELESS and keys.lasts is not None:
        yield ("for",), f"'{kind}' takes no 'for': it is over at once"
    if kind not in TIMELESS and "for" not in written:
        yield (), f"'{kind}' lacks the key 'for': write how long, as in `for: 30 s`"


def _findings(
    keys: FaultKeys, robot: Robot, seconds: float
) -> Iterator[tuple[KeyPath, str]]:
    ends: Mapping[str, KeyPath] = {"target": ("between", 0), "other": ("between", 1)}
    paths = {**_KEYS, **ends} if keys.between else _KEYS
    for field, message in fault_findings(_fault(keys, robot), robot, seconds):
        if field != "other" or keys.between:
            yield paths.get(field, (field,)), message


def _fault(keys: FaultKeys, robot: Robot) -> SimulatedFault:
    anywhere = robot.computers[0].name
    target, other = keys.between or (keys.computer or anywhere, "")
    return SimulatedFault(
        at=keys.at,
        kind=keys.fault,
        target=target,
        other=other,
        lasts=_AT_ONCE if keys.lasts is None else keys.lasts,
        pick=keys.pick,
    )


def _random(robot: Robot, seconds: float, seed: int) -> tuple[SimulatedFault, ...]:
    """Return what a seed picks: the same for every placement."""
    names = [each.name for each in robot.computers]
    kinds = [each for each in KINDS if len(names) > 1 or each not in LINK_KINDS]
    pause = min(_LONGEST_PAUSE, seconds / _FEWEST)
    choices = Choices(seed)
    return tuple(plan_faults(choices, names, 0.0, seconds, kinds, mean_pause=pause))
