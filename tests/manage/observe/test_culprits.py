"""What is named when a computer has too little CPU."""

from __future__ import annotations

from poise.estimate.online import Estimate
from poise.manage.observe.estimates import DemandEstimate, Load, culprit_on

ESTIMATES = tuple(
    DemandEstimate(
        component=name,
        computer="left",
        expected=None,
        demand=demand,
        estimate=Estimate(mean=demand, p95=demand, error=None),
    )
    for name, demand in (("heavy", 0.6), ("light", 0.02))
)


def load(heavy: float, light: float, background: float = 0.0) -> Load:
    components = {"heavy": heavy, "light": light}
    return Load(capacity=1.0, used=1.0, background=background, components=components)


def test_the_culprit_takes_most_beyond_its_demand_and_not_most() -> None:
    found = culprit_on(load(0.6, 0.4), ESTIMATES)
    assert found == "component 'light' takes 0.4 cores there instead of 0.02 cores"


def test_nobody_is_a_culprit_who_takes_what_was_expected() -> None:
    assert culprit_on(load(0.62, 0.02), ESTIMATES) == ""
    assert culprit_on(None, ESTIMATES) == ""


def test_the_victim_is_not_the_culprit() -> None:
    assert culprit_on(load(0.6, 0.4), ESTIMATES, "light") == ""


def test_other_programs_may_be_the_culprit() -> None:
    found = culprit_on(load(0.6, 0.1, 0.3), ESTIMATES)
    assert found == "other programs take 0.3 cores there"


def test_without_a_demand_nothing_is_compared() -> None:
    found = culprit_on(load(0.6, 0.4), ())
    assert found == "component 'heavy' takes 0.6 cores there"
