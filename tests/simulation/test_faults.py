"""Which faults a seed picks."""

from __future__ import annotations

from poise.simulation.choices import Choices
from poise.simulation.faults import KINDS, SimulatedFault, plan_faults


def kinds(seed: int) -> set[str]:
    return {fault.kind for fault in plan_faults(Choices(seed), "abc", 0.0, 200.0)}


def test_a_seed_allows_a_subset_of_the_kinds() -> None:
    subsets = [kinds(seed) for seed in range(30)]
    assert len({frozenset(subset) for subset in subsets}) > 20
    assert max(map(len, subsets)) < len(KINDS)


def test_all_kinds_come_in_some_run() -> None:
    assert set().union(*map(kinds, range(60))) == set(KINDS)


def test_all_faults_are_over_in_time() -> None:
    for seed in range(30):
        for fault in plan_faults(Choices(seed), "abc", 5.0, 60.0):
            assert 5.0 <= fault.at < fault.at + fault.lasts < 60.0


def test_a_link_has_two_ends() -> None:
    for seed in range(30):
        for fault in plan_faults(Choices(seed), "abc", 5.0, 60.0):
            assert fault.other != fault.target
            assert bool(fault.other) == (
                fault.kind in {"cut link", "cut one way", "clog link"}
            )


def test_what_loses_datagrams_everywhere_names_no_computer() -> None:
    fault = SimulatedFault(at=1.0, kind="lose datagrams", target="a", lasts=2.0)
    assert str(fault) == "1.00 s: lose datagrams everywhere for 2.00 s"


def test_of_what_is_over_at_once_nothing_says_how_long() -> None:
    fault = SimulatedFault(at=1.0, kind="kill container", target="a")
    assert str(fault) == "1.00 s: kill container a"
