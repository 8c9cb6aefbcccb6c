"""What users may import is a short list, and changes only on purpose."""

from __future__ import annotations

import ast
import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import poise

SOURCE = Path(__file__).parents[1] / "src"
STUBS = sorted(SOURCE.rglob("*.pyi"))

PUBLIC = {
    "poise": [
        "Calibration",
        "CallError",
        "CalleeError",
        "Component",
        "Message",
        "Placement",
        "PoiseError",
        "Problem",
        "Profiling",
        "Provided",
        "Published",
        "Required",
        "Robot",
        "RobotError",
        "RunError",
        "RunReport",
        "Running",
        "Stamp",
        "Timeout",
        "Unavailable",
        "UsageError",
        "calibrate",
        "check",
        "connect",
        "every",
        "load",
        "loan",
        "oneway",
        "place",
        "profile",
        "run",
        "subscribed",
        "time_left",
        "up",
        "within",
    ],
    "poise.emulate": [
        "EmulatedComputer",
        "Emulation",
        "Probe",
        "StarvationWatch",
        "Usage",
        "is_starved",
        "look",
        "sweep",
    ],
    "poise.model": ["load"],
    "poise.plan": [
        "Bundle",
        "Conflict",
        "Edge",
        "Explanation",
        "Item",
        "LinkCapacity",
        "More",
        "Option",
        "Planner",
        "Problem",
        "Rejection",
        "Result",
        "Smallest",
        "Step",
        "Terms",
        "Tightest",
        "Trial",
        "add",
        "evaluate",
        "explain",
        "keep_components",
        "load",
        "problem_of",
        "scale",
        "schema",
        "smallest",
        "solve",
        "static",
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


def test_every_other_part_is_for_poise_itself() -> None:
    found = {
        module.name
        for module in pkgutil.iter_modules(poise.__path__, "poise.")
        if module.ispkg and hasattr(import_module(module.name), "__all__")
    }
    assert found == PUBLIC.keys() - {"poise"}


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
