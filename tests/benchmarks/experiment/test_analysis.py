"""What pairs of runs decide, by the criteria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest

from benchmarks.experiment.analysis import (
    SUBJECT,
    Comparison,
    compared,
    headline,
    hodges_lehmann,
    voided,
    worst_chain,
)
from benchmarks.experiment.measure import declared_chains
from benchmarks.experiment.results import Missed, Trial, TrialResult
from poise.model.robot import Architecture, Chain, ComponentEntry, Robot


def run(
    arm: str, seed: int, missed: int, invalid: str = "", speed: float = 1.0
) -> TrialResult:
    return TrialResult(
        trial=Trial(arm, "usual", seed),
        at=0.0,
        invalid=invalid,
        chains={"good": Missed(of=50, missed=0), "bad": Missed(of=1000, missed=missed)},
        speeds=(speed, speed),
    )


def comparison(ours: Sequence[int], theirs: Sequence[int]) -> Comparison:
    """Return Poise against another way; of 1,000 uses so many are missed each."""
    results = [run(SUBJECT, seed, missed) for seed, missed in enumerate(ours)]
    results += [run("greedy", seed, missed) for seed, missed in enumerate(theirs)]
    (found,) = compared(results, [SUBJECT, "greedy"], ["usual"])
    return found


def test_the_worst_declared_chain_counts_and_what_never_came_was_missed() -> None:
    assert worst_chain(run(SUBJECT, 0, 100)) == 0.1
    nothing = TrialResult(
        trial=Trial("a", "usual", 0), at=0.0, chains={"c": Missed(of=0, missed=0)}
    )
    assert worst_chain(nothing) == 1.0


def test_hodges_and_lehmann_by_hand() -> None:
    """Means of pairs of 1, 2, 9: 1, 1.5, 2, 5, 5.5, 9."""
    assert hodges_lehmann([1.0, 2.0, 9.0]) == 3.5


@pytest.mark.slow
def test_large_differences_are_decided_both_ways() -> None:
    few, many = [10 + i for i in range(12)], [300 + 3 * i for i in range(12)]
    better, worse = comparison(few, many), comparison(many, few)
    assert (better.verdict, worse.verdict) == ("better", "worse")
    assert better.effect == pytest.approx(-0.301)
    assert better.p is not None
    assert better.p < 0.01
    assert better.effect is not None
    assert better.low is not None
    assert better.high is not None
    assert better.low <= better.effect <= better.high


@pytest.mark.slow
def test_small_differences_are_as_good_also_where_the_test_sees_them() -> None:
    same = comparison([10] * 12, [10] * 12)
    assert (same.verdict, same.p, same.effect) == ("as good", 1.0, 0.0)
    assert comparison([10] * 12, [12] * 12).verdict == "as good"


@pytest.mark.slow
def test_few_pairs_and_noise_decide_nothing() -> None:
    assert comparison([0] * 3, [900] * 3).verdict == "undecided"
    noisy = comparison([0, 900] * 6, [500, 400] * 6)
    assert noisy.verdict == "undecided"


def test_too_many_invalid_runs_are_no_measurement() -> None:
    results = [run(SUBJECT, seed, 0) for seed in range(9)]
    results += [run("greedy", seed, 900) for seed in range(5)]
    results += [run("greedy", seed, 900, "broken") for seed in range(5, 9)]
    (found,) = compared(results, [SUBJECT, "greedy"], ["usual"])
    assert (found.verdict, found.effect) == ("not measured", None)


@pytest.mark.slow
def test_p_values_are_those_of_all_comparisons_together() -> None:
    results = []
    for arm, missed in {SUBJECT: 0, "greedy": 300, "static": 600}.items():
        results += [run(arm, seed, missed + seed) for seed in range(12)]
    one, two = compared(results, [SUBJECT, "greedy", "static"], ["usual"])
    alone = comparison(range(12), range(300, 312))
    assert one.p == two.p
    assert alone.p is not None
    assert one.p == pytest.approx(2 * alone.p)


def test_runs_on_a_machine_of_another_speed_are_void() -> None:
    results = [run("a", seed, 0) for seed in range(5)] + [run("a", 5, 0, speed=0.8)]
    *usual, slow = voided(results)
    assert not any(each.invalid for each in usual)
    assert slow.invalid == "the machine's speed was 20% off the median of the series"


@pytest.mark.parametrize(
    ("verdicts", "said"),
    [
        ({"greedy": "better", "static": "better"}, "Poise wins under all of 1 cond"),
        ({"greedy": "as good", "static": "better"}, "Poise does not win. Not beaten"),
        ({"greedy": "worse", "random": "better"}, "greedy (usual: worse)"),
        ({"greedy": "not measured"}, "Nothing is decided"),
    ],
)
def test_the_headline_says_who_is_not_beaten(
    verdicts: Mapping[str, str], said: str
) -> None:
    found = [
        Comparison(condition="usual", other=name, pairs=9, verdict=verdict)  # type: ignore[arg-type]
        for name, verdict in verdicts.items()
    ]
    assert said in headline(found)


def test_chains_of_alternatives_do_not_count_and_suspended_ones_do() -> None:
    def architecture(name: str, function: str) -> Architecture:
        component = ComponentEntry(name=f"{name}-part")
        return Architecture(name=name, function=function, components=(component,))

    robot = Robot(
        name="tried",
        computers=(),
        architectures=(
            architecture("large", "see"),
            architecture("small", "see"),
            architecture("talk", "talk"),
        ),
        chains=tuple(
            Chain(name=name, through=(f"{name}-part",), deadline=1.0)
            for name in ("large", "small", "talk")
        ),
    )
    assert list(declared_chains(robot, {"small-part"})) == ["small", "talk"]
