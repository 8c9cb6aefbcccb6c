"""What users may import is a short list, and changes only on purpose."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import poise

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
STUBS = sorted(SOURCE.rglob("*.pyi"))

PUBLIC = {
    "poise": [
        "AlreadyManaged",
        "Calibration",
        "CallError",
        "CalleeError",
        "CannotCross",
        "Component",
        "Conditions",
        "Deployed",
        "Drawing",
        "FileProblem",
        "JournalEntry",
        "Message",
        "NoManager",
        "Placement",
        "Playback",
        "PoiseError",
        "PolicyAction",
        "PolicyEvent",
        "Profiling",
        "Provided",
        "Published",
        "RecordedRun",
        "Required",
        "Robot",
        "RobotError",
        "RobotRecording",
        "RolledBack",
        "RunError",
        "RunReport",
        "Running",
        "RunningComponent",
        "Seen",
        "SimulatedFault",
        "Simulation",
        "SimulationComparison",
        "Stamp",
        "StartedCall",
        "Status",
        "TakenOver",
        "Timeout",
        "Unavailable",
        "UsageError",
        "calibrate",
        "check",
        "compare_simulations",
        "connect",
        "deploy",
        "draw",
        "emulated",
        "every",
        "found",
        "load",
        "loan",
        "lost",
        "note_outcome",
        "oneway",
        "place",
        "play",
        "profile",
        "published",
        "read_journal",
        "record",
        "run",
        "simulate",
        "status_without_manager",
        "stop_without_manager",
        "subscribed",
        "test_policies",
        "time_left",
        "up",
        "within",
    ],
    "poise.emulate": [
        "EmulatedComputer",
        "EmulatedSet",
        "Emulation",
        "InjectedFault",
        "Probe",
        "StarvationWatch",
        "Usage",
        "all_sets",
        "background_load",
        "find_set",
        "full_speed",
        "is_starved",
        "probe_host",
        "set_for",
        "sweep",
    ],
    "poise.model": [
        "Action",
        "Architecture",
        "Chain",
        "ComponentEntry",
        "Computer",
        "Connector",
        "ConnectorEnd",
        "DeclaredPort",
        "Device",
        "Generated",
        "Link",
        "Objective",
        "Prefetch",
        "Robot",
        "Simulator",
        "Task",
        "Workload",
        "load",
    ],
    "poise.plan": [
        "Bundle",
        "ComputerTried",
        "Conflict",
        "Edge",
        "Explanation",
        "GreedyStep",
        "Hop",
        "Item",
        "Margin",
        "More",
        "Option",
        "Overload",
        "PRICE",
        "PhaseMove",
        "PhaseProblem",
        "Planner",
        "Problem",
        "Rejection",
        "Result",
        "Run",
        "Shortage",
        "Smallest",
        "SoftLimit",
        "TaskProblem",
        "TaskResult",
        "Terms",
        "Tightest",
        "TimeLimit",
        "TimeTaken",
        "add",
        "evaluate",
        "explain",
        "keep_components",
        "load",
        "problem_of",
        "scale",
        "schema",
        "share_cpu",
        "smallest",
        "solve",
        "solve_phases",
        "static",
        "task_problem_of",
        "with_small_terms",
        "without",
    ],
    "poise.testing": ["Bench", "VirtualClock"],
}


@pytest.mark.parametrize("part", PUBLIC)
def test_a_part_offers_what_is_written_here(part: str) -> None:
    assert sorted(import_module(part).__all__) == PUBLIC[part]


@pytest.mark.parametrize("part", PUBLIC)
def test_all_that_a_part_offers_is_there(part: str) -> None:
    module = import_module(part)
    assert [name for name in PUBLIC[part] if not hasattr(module, name)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["load", "up", "run", "simulate", "place", "connect"])
def test_a_name_is_there_whatever_is_asked_for_first(name: str) -> None:
    argv = [sys.executable, "-c", f"from poise import {name}"]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr


def test_every_other_part_is_for_poise_itself() -> None:
    found = {
        module.name
        for module in pkgutil.iter_modules(poise.__path__, "poise.")
        if module.ispkg and hasattr(import_module(module.name), "__all__")
    }
    assert found == PUBLIC.keys() - {"poise", "poise.testing"}


MODULES = {*PUBLIC, "poise.errors", "poise.tasks", "poise.units"}
"""What users may import from."""
INTERNALS = "It imports internal modules: "
"""A benchmark of an internal layer, or a file of the demo, says so, and why."""


@pytest.mark.parametrize("folder", ["examples", "benchmarks"])
def test_examples_and_benchmarks_use_what_users_may(folder: str) -> None:
    private = [
        f"{file.relative_to(ROOT)}: {module}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for tree in [ast.parse(file.read_text())]
        if not may_use_internals(file)
        or INTERNALS not in (ast.get_docstring(tree) or "")
        for module in imported(tree)
        if module.partition(".")[0] == "poise" and module not in MODULES
    ]
    assert private == []


def may_use_internals(file: Path) -> bool:
    """Return whether it is a benchmark, or of the demo, which is no robot's code."""
    top, second, *_ = file.relative_to(ROOT).parts
    return top == "benchmarks" or second == "demo"


def imported(tree: ast.Module) -> Iterator[str]:
    """Yield the modules that a file imports, wherever it does."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("stub", STUBS, ids=lambda path: path.stem)
def test_every_native_name_is_described(stub: Path) -> None:
    """Ruff sees to the docstrings of Python; of native code it knows nothing."""
    relative = stub.relative_to(SOURCE).with_suffix("")
    native = import_module(".".join(relative.parts))
    undescribed = [
        node.name
        for node in ast.parse(stub.read_text()).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef)
        and not ast.get_docstring(node)
        and not getattr(native, node.name).__doc__
    ]
    assert undescribed == []


@pytest.mark.slow
def test_a_class_name_says_one_thing_only() -> None:
    places: dict[str, list[str]] = {}
    for file in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(str(file.relative_to(SOURCE)))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
