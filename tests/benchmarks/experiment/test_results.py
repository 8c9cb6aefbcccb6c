"""Raw results are kept, and an experiment goes on with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.experiment.results import Trial, TrialResult, append, read, remaining
from poise.errors import UsageError

TRIALS = [Trial(arm, "usual", seed) for seed in range(2) for arm in ("a", "b")]


def test_what_is_appended_is_read(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert read(file) == []
    results = [
        TrialResult(trial=trial, at=1.0, functions={"x": True}) for trial in TRIALS
    ]
    for result in results:
        append(file, result)
    assert read(file) == results
    assert len(file.read_text().splitlines()) == len(TRIALS)


def test_a_line_that_was_cut_off_is_made_again(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    results = [TrialResult(trial=trial, at=1.0) for trial in TRIALS]
    append(file, results[0])
    with file.open("a") as out:
        out.write('{"trial": {"arm"')
    assert read(file) == results[:1]
    append(file, results[1])
    assert read(file) == results[:2]


def test_a_line_that_is_no_result_is_named(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    append(file, TrialResult(trial=TRIALS[0], at=1.0))
    with file.open("a") as out:
        out.write("nonsense\n")
    with pytest.raises(UsageError, match="line 2 is no result"):
        read(file)


def test_invalid_runs_are_made_again() -> None:
    done = TrialResult(trial=TRIALS[0], at=1.0)
    broken = TrialResult(trial=TRIALS[1], at=1.0, invalid="the world died")
    assert remaining(TRIALS, [done, broken]) == TRIALS[1:]
    again = TrialResult(trial=TRIALS[1], at=2.0)
    assert remaining(TRIALS, [done, broken, again]) == TRIALS[2:]
