"""Makes the runs of an experiment, and goes on where one was ended.

It imports internal modules: it measures runs from outside.
"""

from __future__ import annotations

import math
import os
import subprocess
import time
from pathlib import Path

from msgspec.structs import replace

from benchmarks.experiment.analysis import compared, headline, voided
from benchmarks.experiment.measure import measure
from benchmarks.experiment.page import experiment_page
from benchmarks.experiment.results import (
    Extent,
    TrialResult,
    append,
    named,
    read,
    remaining,
    schedule,
)
from benchmarks.experiment.summary import ExperimentReport, summarised
from poise.errors import UsageError
from poise.model.robot import Robot
from poise.session import Check, Say
from poise.session.folders import to_write
from poise.session.profiling.stored_profiles import steady
from poise.units import counted

RAW = "results.jsonl"
PAGE = "report.html"
_SECONDS = 20.0
"""How long each run is measured [s]."""


def experiment(  # noqa: PLR0913 - each is an option of the command
    robot: Robot,
    task: str,
    extent: Extent,
    folder: Path,
    *,
    seconds: float = _SECONDS,
    hours: float = math.inf,
    say: Say,
    check: Check,
) -> ExperimentReport:
    """Make all runs that `folder` has no valid result of; write the page; report.

    No run begins after so many `hours`. Ctrl-C (`KeyboardInterrupt`) ends it after the
    page of what is known was written.

    Raises
    ------
    UsageError
        The folder cannot be written, or has results of something else.
    """
    raw = folder / RAW
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder} cannot be written: {error.strerror}") from error
    to_write(raw)
    trials = schedule(extent)
    results = [each for each in read(raw) if each.trial in trials]
    todo = remaining(trials, voided(results))
    if results:
        say(f"{raw} has {counted(len(results), 'run')}; {len(todo)} are to be made")
    renamed = replace(robot, name=f"{robot.name}-{os.getpid()}")
    began = time.monotonic()
    try:
        for done, trial in enumerate(todo, 1):
            if time.monotonic() - began > 3600 * hours:
                say(f"{hours:g} h are over: {len(todo) + 1 - done} runs are left")
                break
            arm = named(extent.arms, trial.arm)
            condition = named(extent.conditions, trial.condition)
            with steady(robot):
                result = measure(
                    renamed, task, arm, condition, trial.seed, seconds, check
                )
            append(raw, result)
            results.append(result)
            more = (time.monotonic() - began) / done * (len(todo) - done)
            say(f"{done} of {len(todo)}, {_minutes(more)} left: {_told(result)}")
    finally:
        results = voided(results)
        arms = [each.name for each in extent.arms]
        conditions = [each.name for each in extent.conditions]
        comparisons = compared(results, arms, conditions)
        left = remaining(trials, results)
        state = f"Preliminary, {counted(len(left), 'run')} to go. " if left else ""
        report = ExperimentReport(
            robot=robot.name,
            seconds=seconds,
            planned=len(trials),
            arms=summarised(results, arms, conditions, robot.functions_of(task)),
            comparisons=comparisons,
            headline=state + headline(comparisons),
            criteria=_commit_of_criteria(),
        )
        page = experiment_page(report, extent, results)
        (folder / PAGE).write_text(page, encoding="utf-8")
    return report


def _commit_of_criteria() -> str:
    """Return which commit the criteria are of; empty: this is no clone."""
    asked = ("git", "log", "-1", "--format=%h of %cs", "--", "criteria.md")
    try:
        done = subprocess.run(
            asked, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()


def _minutes(seconds: float) -> str:
    return f"about {seconds / 60:.0f} min" if seconds > 90 else f"{seconds:.0f} s"


def _told(result: TrialResult) -> str:
    """Return a result for people."""
    trial = result.trial
    what = f"{trial.arm}, {trial.condition}, seed {trial.seed}"
    if result.invalid:
        return f"{what}: invalid, {result.invalid}"
    failed = [name for name, works in result.functions.items() if not works]
    return f"{what}: {', '.join(failed) + ' failed' if failed else 'all worked'}"
