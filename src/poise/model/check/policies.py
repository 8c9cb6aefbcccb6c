"""Policies: complete, with conditions and actions that their subject has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from poise.model.check.file_paths import component_names
from poise.model.policy.condition import check_sentence, parse_condition
from poise.model.policy.policy import ACTIONS, Policy
from poise.model.policy.shipped import policies_of, shipped
from poise.model.policy.values import SUBJECTS, Subject
from poise.model.robot import Robot
from poise.model.yaml.positions import Finding
from poise.suggest import did_you_mean, listed, unknown


def check_policies(robot: Robot) -> Iterator[Finding]:
    """Yield what is wrong with the policies of a robot."""
    known = {policy.name for policy in shipped()}
    written = {policy.name for policy in robot.policies}
    for policy in policies_of(robot):
        if policy.name not in written:
            continue
        if policy.off:
            if policy.name not in known:
                yield _finding(
                    policy,
                    "",
                    f"Poise ships no policy '{policy.name}'"
                    f"{did_you_mean(policy.name, known)}; policies: {listed(known)}",
                )
        elif policy.call:
            yield from _own_function(policy)
        else:
            yield from _one(robot, policy)


def _one(robot: Robot, policy: Policy) -> Iterator[Finding]:
    keys = {"for each": policy.for_each, "when": policy.when, "do": policy.do}
    missing = [key for key, value in keys.items() if value is None]
    if missing:
        yield _finding(policy, "", f"a policy of your own needs {listed(missing)}")
    if policy.for_each is None or policy.when is None:
        return
    record = SUBJECTS[policy.for_each]
    try:
        parse_condition(policy.when, record, choices_of(robot, policy.for_each))
    except ValueError as error:
        yield _finding(policy, "when", str(error))
    try:
        check_sentence(policy.say or "", record)
    except ValueError as error:
        yield _finding(policy, "say", str(error))
    if policy.do is not None and policy.for_each not in ACTIONS[policy.do]:
        of = listed(ACTIONS[policy.do])
        text = f"'{policy.do}' is done for each {of}, not for each '{policy.for_each}'"
        yield _finding(policy, "do", text)
    yield from _targets(robot, policy)


def _own_function(policy: Policy) -> Iterator[Finding]:
    for key, value in (
        ("for each", policy.for_each),
        ("when", policy.when),
        ("do", policy.do),
    ):
        if value is not None:
            text = f"a policy with `call` has no '{key}': its function decides"
            yield _finding(policy, key, text)


def _targets(robot: Robot, policy: Policy) -> Iterator[Finding]:
    computers = [computer.name for computer in robot.computers]
    names = [architecture.name for architecture in robot.architectures]
    if policy.do == "move" and policy.to is None:
        yield _finding(policy, "do", "'move' needs 'to', a computer")
    if policy.to is not None and policy.to not in computers:
        yield _finding(policy, "to", unknown("computer", policy.to, computers))
    if policy.by is not None and policy.by not in names:
        yield _finding(policy, "by", unknown("architecture", policy.by, names))


def choices_of(robot: Robot, subject: Subject) -> Mapping[str, tuple[str, ...]]:
    """Return the names that values of a subject may have."""
    computers = tuple(computer.name for computer in robot.computers)
    names = {
        "computer": computers,
        "component": component_names(robot),
        "chain": tuple(chain.name for chain in robot.chains),
    }
    return {
        "computer": computers,
        "component": names["component"],
        "architecture": tuple(each.name for each in robot.architectures),
        "name": names.get(subject, ()),
    }


def _finding(policy: Policy, key: str, message: str) -> Finding:
    path = ("policies", policy.name, *([key] if key else []))
    return Finding(path, f"policy '{policy.name}': {message}")
