"""What commands print with `--json`, as a JSON Schema (draft 2020-12).

`python -m poise.cli.json_outputs > docs/output.schema.json` writes it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import msgspec

from poise.cli.emulate_command import ListedSet
from poise.cli.keys_command import KeysListed
from poise.cli.run_command import demo_module
from poise.errors import FileProblem
from poise.estimate.profiles import Profile
from poise.manage.control_socket.commands import Rebalanced, RobotStatus
from poise.manage.journal import JournalEntry
from poise.manage.migration.migration_report import MigrationReport, WhatIf
from poise.manage.observe.estimates import DemandEstimate
from poise.manage.tasks.task_reports import TaskReport
from poise.model.policy import Policy
from poise.model.schema import flush_left
from poise.plan.phase_result import PlainPhases
from poise.plan.result_records import PlainResult
from poise.session.deploy.deploy import Deployed
from poise.session.profiling.calibrate import Calibration
from poise.session.robot_file import Described, Listed
from poise.session.run_report import RunReport
from poise.session.running_robots.local_robots import Rate, Robots
from poise.session.running_robots.playback import Playback
from poise.simulation.predicted_times import PredictedTimes
from poise.simulation.simulation_report import SimulationReport
from poise.view.robot_recording import RobotRecording
from poise.wire.records.request_records import OutputLine


class Failed(TypedDict):
    """An error, of any command."""

    error: str
    kind: str
    problems: list[FileProblem]


class Checked(TypedDict):
    """What `poise check` found."""

    ok: bool
    problems: list[FileProblem]
    # What a person should know though nothing is wrong
    notes: list[str]


class Fired(TypedDict):
    """What a policy would have done, by `poise policy test`."""

    at: float
    policy: str
    do: str | None
    about: str
    computer: str
    what: str
    saw: dict[str, Any]


class JournalShown(TypedDict):
    """What `poise journal` shows."""

    entries: list[JournalEntry]


class Echoed(TypedDict):
    """A line of `poise echo`: when it went out [s since 1970], and what."""

    at: float
    value: Any


class PlannedPlacement(PlainResult, total=False):
    """A placement, and what is predicted of its only phase; with --explain why."""

    predicted: Mapping[str, PredictedTimes]
    explanation: dict[str, Any]


class PlannedPhases(PlainPhases, total=False):
    """The placements of a task, what is predicted by phase; with --explain why."""

    predicted: Mapping[str, PredictedTimes]
    phase: str
    explanation: dict[str, Any]


class Compared(TypedDict):
    """Placements by method, or by task, side by side."""

    results: Mapping[str, Any]


class ComparedSimulations(TypedDict):
    """Simulations by method of placement, and why others have no result."""

    results: Mapping[str, SimulationReport]
    without: Mapping[str, str]


class SmallestShown(TypedDict):
    """The cheapest computers for tasks."""

    feasible: bool
    computers: list[str]
    price: float
    smallest_proven: bool
    tasks: Mapping[str, PlannedPhases]


class Called(TypedDict):
    """What a method returned, with arrays as lists."""

    result: Any


OUTPUTS: Mapping[str, Sequence[Any]] = {
    "check": [Checked],
    "plan": [PlannedPlacement, PlannedPhases, Compared, SmallestShown],
    "simulate": [SimulationReport, ComparedSimulations],
    "profile": [Profile],
    "profile show": [Profile],
    "calibrate": [Calibration],
    "recording": [list[DemandEstimate]],
    "policy": [list[Policy], list[Fired]],
    "repository": [list[Listed]],
    "repository list": [list[Listed]],
    "repository show": [Described],
    "run": [RunReport],
    "demo": demo_module().OUTPUTS,
    "emulate list": [list[ListedSet]],
    "deploy": [Deployed],
    "keys": [list[KeysListed]],
    "keys list": [list[KeysListed]],
    "list": [Robots, list[str]],
    "call": [Called],
    "param": [dict[str, dict[str, Any]]],
    "param list": [dict[str, dict[str, Any]]],
    "param get": [dict[str, Any]],
    "param set": [dict[str, Any]],
    "record": [RobotRecording],
    "play": [Playback],
    "echo": [Echoed],
    "hz": [Rate],
    "log": [OutputLine],
    "task": [list[TaskReport]],
    "task list": [list[TaskReport]],
    "task show": [TaskReport],
    **{f"task {act}": [TaskReport] for act in ("start", "pause", "resume", "cancel")},
    "status": [RobotStatus],
    "move": [MigrationReport, WhatIf],
    "replace": [MigrationReport],
    "balance": [Rebalanced],
    "journal": [JournalShown],
}
"""Command -> what it prints, or one of these; of `echo`, `hz` and `log` each line."""


_REF = "#/$defs/{name}"


def schema() -> dict[str, Any]:
    """Return the schema; ``$defs`` has what each command prints, by its name."""
    types = [output for several in OUTPUTS.values() for output in several]
    found, records = msgspec.json.schema_components([*types, Failed], ref_template=_REF)
    # what a command prints may also be an error
    schemas = iter(found)
    commands = {
        name: {"anyOf": [*(next(schemas) for _ in several), found[-1]]}
        for name, several in OUTPUTS.items()
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What Poise's commands print with --json",
        "$defs": {**commands, **flush_left(records)},
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(schema(), indent=1) + "\n")
