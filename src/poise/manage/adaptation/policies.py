"""Evaluates the policies of a robot: what holds now, and for how long. Pure.

`model/policy/shipped.yaml` has those that Poise ships.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from msgspec import Struct

from poise.model.policy.condition import Condition, parse_condition, sentence
from poise.model.policy.policy import COOL_DOWN, LASTS, Policy
from poise.model.policy.values import SUBJECTS, Subject, Values

Key = tuple[str, str, str]
"""A policy, a subject, and the computer where that is."""
Read = Callable[[Subject], tuple[Values, ...]]
"""Returns the values of all subjects of a kind."""


class Symptom(Struct, frozen=True, kw_only=True):
    """A subject for which the condition of a policy holds.

    Parameters
    ----------
    what
        A sentence for people.
    values
        What was seen.
    """

    policy: Policy
    what: str
    values: Values

    @property
    def key(self) -> Key:
        """What makes it the same one as before."""
        return _key(self.policy, self.values)

    @property
    def computer(self) -> str:
        """Where it is; empty: nowhere in particular."""
        is_computer = self.policy.for_each == "computer"
        return self.values.name if is_computer else self.key[2]


class Policies:
    """The policies of one robot, and since when their conditions hold.

    All times are of one clock that never goes back [s].

    Attributes
    ----------
    since
        The symptoms that are there now -> when each was seen first.
    """

    def __init__(self, policies: Iterable[Policy]) -> None:
        self._policies = [(p, _condition(p)) for p in policies if not p.off]
        self._acted: dict[Key, float] = {}
        self.since: Mapping[Key, float] = {}

    @property
    def subjects(self) -> tuple[Subject, ...]:
        """The kinds of subjects that they ask about."""
        kinds = {p.for_each for p, _ in self._policies}
        return tuple(subject for subject in SUBJECTS if subject in kinds)

    def look(self, read: Read, now: float) -> tuple[Symptom, ...]:
        """Return the symptoms that have been there at every look for long enough."""
        values = {subject: read(subject) for subject in self.subjects}
        found = {
            _key(policy, each): (policy, each)
            for policy, holds in self._policies
            if policy.for_each is not None
            for each in values[policy.for_each]
            if holds(each)
        }
        self.since = {key: self.since.get(key, now) for key in found}
        return tuple(
            Symptom(policy=policy, what=sentence(policy.say or "", each), values=each)
            for key, (policy, each) in found.items()
            if now - self.since[key] >= _or(policy.lasts, LASTS)
        )

    def due(self, symptoms: Iterable[Symptom], now: float) -> tuple[Symptom, ...]:
        """Return the symptoms about which something may be done: none cools down."""
        return tuple(
            each
            for each in symptoms
            if now - self._acted.get(each.key, float("-inf"))
            >= _or(each.policy.cool_down, COOL_DOWN)
        )

    def note_acted(self, symptoms: Iterable[Symptom], now: float) -> None:
        """Remember that something was done about symptoms."""
        self._acted |= {each.key: now for each in symptoms}


def _key(policy: Policy, values: Values) -> Key:
    return policy.name, values.name, getattr(values, "computer", "")


def _condition(policy: Policy) -> Condition:
    # `poise check` saw to it that these are there
    assert policy.for_each is not None  # noqa: S101
    return parse_condition(policy.when or "", SUBJECTS[policy.for_each])


def _or(seconds: float | None, default: float) -> float:
    return default if seconds is None else seconds
