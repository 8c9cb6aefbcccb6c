"""What runs showed together."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from benchmarks.experiment.results import Missed, Trial, TrialResult
from benchmarks.experiment.summary import summarised, wilson

VALID = TrialResult(
    trial=Trial("a", "usual", 0),
    at=0.0,
    functions={"drive": True, "talk": False},
    world={"path_error": 0.2},
    chains={"pose": Missed(of=10, missed=1, median=0.1, p99=0.3)},
    cpu_share={"main": 0.5},
    decision_seconds=0.01,
)


@pytest.mark.parametrize(
    ("held", "of", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),  # Newcombe (1998), table I, method 3
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_intervals_are_as_published(
    held: int, of: int, low: float, high: float
) -> None:
    found = wilson(held, of)
    assert found.share == held / of
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-5)


def test_an_interval_holds_its_share_and_mirrors() -> None:
    for of in range(1, 30):
        for held in range(of + 1):
            found, other = wilson(held, of), wilson(of - held, of)
            assert found.share is not None
            assert 0 <= found.low <= found.share <= found.high <= 1
            assert found.low == pytest.approx(1 - other.high)


def test_without_a_run_nothing_is_known() -> None:
    found = wilson(0, 0)
    assert (found.share, found.low, found.high) == (None, 0.0, 1.0)
    assert str(found) == "no valid run"


def test_an_invalid_run_is_no_result() -> None:
    """It has neither a share of success nor deadlines, though it says all failed."""
    broken = replace(
        VALID,
        trial=Trial("a", "usual", 1),
        invalid="the simulated world ended",
        functions={"drive": False, "talk": False},
        chains={"pose": Missed(of=10, missed=10, median=9.0, p99=9.0)},
    )
    (arm,) = summarised([VALID, broken], ["a"], ["usual"], ["drive", "talk"])
    assert (arm.runs, arm.invalid) == (2, 1)
    assert (arm.success["drive"].share, arm.success["drive"].of) == (1.0, 1)
    assert arm.success["talk"].share == arm.all_worked.share == 0.0
    assert arm.deadline_miss_share == {"pose": 0.1}
    assert arm.ages == {"pose": 0.1}


def test_an_arm_of_invalid_runs_only_is_there_and_says_nothing() -> None:
    broken = replace(VALID, invalid="broke", functions={}, chains={}, world={})
    found = summarised(
        [broken, replace(VALID, trial=Trial("b", "usual", 0))],
        ["a", "b"],
        ["usual"],
        ["drive", "talk"],
    )
    assert [each.placement for each in found] == ["a", "b"]
    assert found[0].success["drive"].share is None
    assert found[0].path_error is None


def test_deadlines_are_pooled_and_ages_are_medians_over_runs() -> None:
    runs = [
        replace(
            VALID,
            trial=Trial("a", "usual", seed),
            chains={"pose": Missed(of=of, missed=missed, median=age, p99=2 * age)},
        )
        for seed, (of, missed, age) in enumerate(
            [(10, 0, 0.1), (30, 10, 0.5), (0, 0, 0.2)]
        )
    ]
    (arm,) = summarised(runs, ["a"], ["usual"], ["drive", "talk"])
    assert arm.deadline_miss_share == {"pose": 0.25}
    assert (arm.ages, arm.ages_p99) == ({"pose": 0.2}, {"pose": 0.4})


def test_a_function_that_nobody_judged_has_not_failed() -> None:
    (arm,) = summarised([VALID], ["a"], ["usual"], ["drive", "dance"])
    assert (arm.success["dance"].share, arm.success["drive"].share) == (None, 1.0)
