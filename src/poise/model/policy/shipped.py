"""The policies that Poise ships, and those that count for a robot."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Struct

from poise.errors import FileProblem, RobotError
from poise.model.file_keys import says
from poise.model.policy.policy import COOL_DOWN, LASTS, POLICIES, Policy
from poise.model.yaml.tree import Node, parse
from poise.model.yaml.validate import validate

FILE = Path(__file__).with_name("shipped.yaml")


class _Shipped(Struct, frozen=True):
    policies: Annotated[tuple[Policy, ...], POLICIES, says("Poise's own policies.")]


@cache
def shipped() -> tuple[Policy, ...]:
    """Return the policies that Poise ships; a broken file is a bug of Poise."""
    problems: list[FileProblem] = []
    text = FILE.read_text(encoding="utf-8")
    root = parse(text, str(FILE), problems)
    if root is not None:
        top = Node(root.place, {"policies": root})
        found = validate(top, msgspec.inspect.type_info(_Shipped), problems)
        if not problems:
            return msgspec.convert(found, _Shipped).policies
    raise RobotError(problems=problems)


def policies_of(written: Iterable[Policy]) -> tuple[Policy, ...]:
    """Return a robot's policies, `off` ones too: shipped ones first, then its own.

    What a policy of the robot file does not give is that of the shipped one of its
    name, or a default.
    """
    found = {policy.name: policy for policy in shipped()}
    for own in written:
        found[own.name] = _changed(found.get(own.name, Policy(name=own.name)), own)
    return tuple(map(_whole, found.values()))


def _changed(policy: Policy, by: Policy) -> Policy:
    given = {k: v for k, v in msgspec.structs.asdict(by).items() if v is not None}
    return msgspec.structs.replace(policy, **given)


def _whole(policy: Policy) -> Policy:
    return msgspec.structs.replace(
        policy,
        lasts=LASTS if policy.lasts is None else policy.lasts,
        cool_down=COOL_DOWN if policy.cool_down is None else policy.cool_down,
        say=policy.say or f"{policy.for_each} '{{name}}': {policy.when}",
    )
