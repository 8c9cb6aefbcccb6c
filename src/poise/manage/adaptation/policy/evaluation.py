"""Evaluates the policies of a robot: what holds now, and for how long.

`model/policy/shipped.yaml` has those that Poise ships.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from msgspec import Struct, structs

from poise.manage.adaptation.policy.own_function import OwnFunction
from poise.model.policy.condition import Condition, parse_condition, sentence
from poise.model.policy.policy import ACTIONS, COOL_DOWN, LASTS, Policy
from poise.model.policy.seen import PolicyAction, Seen
from poise.model.policy.values import SUBJECTS, Subject, Values

Key = tuple[str, str, str]
"""A policy, a subject, and the computer where that is."""
Read = Callable[[Subject], tuple[Values, ...]]
"""Returns the values of all subjects of a kind; called more than once for each."""


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


Symptoms = tuple[Symptom, ...]


class Policies:
    """The policies of one robot, and since when their conditions hold.

    All times are of one clock that never goes back [s].

    Attributes
    ----------
    since
        The symptoms that are there now -> when each was seen first.
    """

    def __init__(self, policies: Iterable[Policy], folder: str = "") -> None:
        policies = [policy for policy in policies if not policy.off]
        self._policies = [(p, _condition(p)) for p in policies if not p.call]
        self._functions = [(p, OwnFunction(p.call, folder)) for p in policies if p.call]
        self._acted: dict[Key, float] = {}
        self.since: Mapping[Key, float] = {}

    def troubles(self) -> tuple[str, ...]:
        """Return what is wrong with functions, for people."""
        return tuple(
            f"policy '{policy.name}': {function.trouble}"
            for policy, function in self._functions
            if function.trouble
        )

    def close(self) -> None:
        """End the processes of functions."""
        for _, function in self._functions:
            function.close()

    def look(self, read: Read, now: float, *, waits: bool = False) -> Symptoms:
        """Return the symptoms that have been there at every look for long enough.

        Parameters
        ----------
        waits
            Whether to wait for functions; else what they said last counts.
        """
        found = {
            _key(policy, each): (policy, each)
            for policy, holds in self._policies
            if policy.for_each is not None
            for each in read(policy.for_each)
            if holds(each)
        }
        found |= self._by_functions(read, now, waits=waits)
        self.since = {key: self.since.get(key, now) for key in found}
        return tuple(
            Symptom(policy=policy, what=_what(policy, each), values=each)
            for key, (policy, each) in found.items()
            if now - self.since[key] >= _or(policy.lasts, LASTS)
        )

    def _by_functions(
        self, read: Read, now: float, *, waits: bool
    ) -> dict[Key, tuple[Policy, Values]]:
        found = {}
        seen = Seen.by(read, now) if self._functions else Seen(at=now)
        for policy, function in self._functions:
            actions = function.answer(seen) if waits else function.ask(seen)
            for action in actions:
                whole, values = _resolved(policy, action, seen)
                if values is None:
                    text = f"'{policy.call}' names no subject '{action.about}'"
                    function.trouble = f"{text} for '{action.do}'"
                else:
                    found[_key(whole, values)] = whole, values
        return found

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


def _resolved(
    policy: Policy, action: PolicyAction, seen: Seen
) -> tuple[Policy, Values | None]:
    """Return the policy as if it had been written for an action, and its subject."""
    for subject in ACTIONS[action.do]:
        for values in seen.of(subject):
            if values.name == action.about:
                whole = structs.replace(
                    policy,
                    for_each=subject,
                    do=action.do,
                    to=action.to or None,
                    by=action.by or None,
                    force=action.force,
                    say=action.why,
                )
                return whole, values
    return policy, None


def _what(policy: Policy, values: Values) -> str:
    return (policy.say or "") if policy.call else sentence(policy.say or "", values)


def _key(policy: Policy, values: Values) -> Key:
    return policy.name, values.name, getattr(values, "computer", "")


def _condition(policy: Policy) -> Condition:
    # `poise check` saw to it that these are there
    assert policy.for_each is not None  # noqa: S101
    return parse_condition(policy.when or "", SUBJECTS[policy.for_each])


def _or(seconds: float | None, default: float) -> float:
    return default if seconds is None else seconds
