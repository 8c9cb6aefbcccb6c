"""What makes the manager look for another placement.

A trigger is a function from facts to symptoms. Add one here, and to `TRIGGERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from msgspec import Struct

from poise.manage.adaptation.facts import Facts

STARVED = 0.1
"""A component is starved when this share of its jobs is not done."""
LASTS = 0.5
"""A symptom counts when it has lasted for this time [s]."""


class Symptom(Struct, frozen=True):
    """Something that another placement may mend.

    Parameters
    ----------
    trigger
        What found it.
    about
        A computer, or a component's timer.
    computer
        Where.
    what
        A sentence for people.
    """

    trigger: str
    about: str
    computer: str
    what: str

    @property
    def key(self) -> tuple[str, str]:
        """What makes it the same one as before."""
        return self.trigger, self.about


Trigger = Callable[[Facts], Iterator[Symptom]]


def overload(facts: Facts) -> Iterator[Symptom]:
    """Find computers whose CPU is used up while a component there is starved."""
    starved = {
        each.computer
        for each in facts.demand_estimates
        if each.estimate.starved >= STARVED
    }
    late = {each.computer for each in facts.misses if each.is_late}
    for name, load in facts.loads.items():
        if load.is_full and name in starved | late:
            others = ""
            if load.background:
                others = f", {load.background:.2f} of them by other programs"
            yield Symptom(
                "overload",
                name,
                name,
                f"computer '{name}' is overloaded: {load.used:.2f} of "
                f"{load.capacity:.2f} cores are used{others}",
            )


def deadlines(facts: Facts) -> Iterator[Symptom]:
    """Find timers that miss their deadlines."""
    for each in facts.misses:
        if each.is_late:
            yield Symptom(
                "deadlines",
                f"{each.component}.{each.timer}",
                each.computer,
                f"timer '{each.timer}' of component '{each.component}' on "
                f"'{each.computer}' missed {each.missed} of {each.released} deadlines "
                f"within {each.seconds:g} s",
            )


TRIGGERS: tuple[Trigger, ...] = (overload, deadlines)


class LastingSymptoms:
    """Selects the symptoms that last.

    Parameters
    ----------
    seconds
        How long a symptom must have lasted [s].
    """

    def __init__(self, seconds: float = LASTS) -> None:
        self._seconds = seconds
        self._since: dict[tuple[str, str], float] = {}

    @property
    def since(self) -> Mapping[tuple[str, str], float]:
        """When each symptom that is there now was seen first."""
        return self._since

    def select(self, symptoms: Iterable[Symptom], now: float) -> tuple[Symptom, ...]:
        """Return those that have been there at every look for long enough."""
        found = {each.key: each for each in symptoms}
        self._since = {key: self._since.get(key, now) for key in found}
        return tuple(
            each
            for key, each in found.items()
            if now - self._since[key] >= self._seconds
        )
