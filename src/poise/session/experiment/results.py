"""The raw results: a line of JSON for each run, in a file that only grows."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from poise.errors import UsageError
from poise.session.experiment.trials import Trial


class Missed(Struct, frozen=True, kw_only=True):
    """How often a timer was due or a chain's data was used, and how often too late.

    Of a chain `median` and `p99` are ages of its data when it was used [s].
    """

    of: int
    missed: int
    median: float | None = None
    p99: float | None = None


class TrialResult(Struct, frozen=True, kw_only=True):
    """What one run showed.

    Parameters
    ----------
    at
        When it began [s since 1970].
    invalid
        Why it says nothing about the robot; empty: it does.
    seconds
        How long it was measured [s].
    placement
        Component -> computer, at the start.
    decision_seconds
        How long that took to decide [s].
    put_aside
        Architectures that did not run, because not all fits.
    functions
        Function -> whether it worked, as the simulated world saw it.
    world
        The world's other results.
    chains, timers
        How each kept its deadline.
    cpu_share
        Computer -> CPU used, as a share of what it has.
    moves
        How many components moved while it ran.
    world_waited
        How long the simulated world was ready to run and got no CPU [s].
    host_load
        Load average of this machine when it began.
    """

    trial: Trial
    at: float
    invalid: str = ""
    seconds: float = 0.0
    placement: Mapping[str, str] = {}
    decision_seconds: float = 0.0
    put_aside: tuple[str, ...] = ()
    functions: Mapping[str, bool] = {}
    world: Mapping[str, Any] = {}
    chains: Mapping[str, Missed] = {}
    timers: Mapping[str, Missed] = {}
    cpu_share: Mapping[str, float] = {}
    moves: int = 0
    world_waited: float = 0.0
    host_load: float = 0.0


def append(file: Path, result: TrialResult) -> None:
    """Add a result; it is on the disk when this returns."""
    with file.open("ab") as out:
        out.write(msgspec.json.encode(result) + b"\n")
        out.flush()
        os.fsync(out.fileno())


def read(file: Path) -> list[TrialResult]:
    """Return the results in a file; none where there is no file.

    A last line that was cut off, as by a loss of power, is taken out of the file.

    Raises
    ------
    UsageError
        Another line is no result.
    """
    if not file.exists():
        return []
    lines = file.read_bytes().splitlines(keepends=True)
    if lines and not lines[-1].endswith(b"\n"):
        os.truncate(file, sum(map(len, lines[:-1])))
        lines = lines[:-1]
    found = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(msgspec.json.decode(line, type=TrialResult))
        except msgspec.DecodeError as error:
            raise UsageError(
                f"{file}, line {number} is no result ({error}): remove it, or give "
                "another folder with --report"
            ) from error
    return found


def remaining(trials: Iterable[Trial], results: Iterable[TrialResult]) -> list[Trial]:
    """Return the trials without a valid result: invalid runs are made again."""
    done = {each.trial for each in results if not each.invalid}
    return [trial for trial in trials if trial not in done]
