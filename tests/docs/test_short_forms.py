"""Every `python -m` command of the documents runs, in a form that is short."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").rglob("*.md"),
    *(ROOT / "examples").rglob("*.md"),
    *(ROOT / "benchmarks").rglob("*.md"),
]
SHORT_FORMS = {
    "benchmarks.adaptation": "--quick --only decision --json",
    "benchmarks.calls": "--quick --only direct --json",
    "benchmarks.dashboard": "--seconds 1 --components 5 --kbit 1000",
    "benchmarks.data_age": "--seconds 2 --starts 1 --only 1 --json",
    "benchmarks.drive": "--times 1 --json",
    "benchmarks.encryption": "--quick --json",
    "benchmarks.estimate": "--quick --json",
    "benchmarks.experiment": "--one --json --folder {folder}",
    "benchmarks.faults": "--quick --json",
    "benchmarks.idle": "--quick --json",
    "benchmarks.learning": "--seeds 4 --json",
    "benchmarks.lease": "",
    "benchmarks.moves": "--quick --json",
    "benchmarks.placement": "--quick --only proof --json",
    "benchmarks.prefetch": "--seconds 5 --json",
    "benchmarks.priorities": "--rounds 1 --seconds 2",
    "benchmarks.regret": "--seeds 1 --kinds lost --json",
    "benchmarks.ros2_bridge": "--quick",
    "benchmarks.simulation": "--seconds 3 --only two --json",
    "benchmarks.starvation": "",
    "benchmarks.takeover": "--moves 5 --json",
    "tests.chaos": "10s --folder {folder}",
    "tests.simulation": "2",
}
BUSY = {"benchmarks.experiment": '"invalid":1'}
"""Module -> what it prints when the tests beside it leave it too little CPU; it then
exits with 1."""
EXEMPT = {
    "tests.leader_kills": "needs network namespaces; tests/session/test_standbys.py",
    "tests.simulation.mutations": "takes an hour; tests/simulation/test_mutations.py",
    "trot.world": "runs until the robot ends it; the demo's tests start it",
    "trot.world.record": "needs a program that makes speech, and rewrites a file",
}
"""Module -> why it has no short form, and what else runs it."""


def commands() -> Iterator[tuple[str, str]]:
    """Yield module and options of each command that a document names."""
    for document in DOCUMENTS:
        text = re.sub(r"\n *", " ", document.read_text())
        yield from re.findall(
            r"python -m ((?:benchmarks|tests|trot)[\w.]*)([^`#$|]*)", text
        )


NAMED = sorted(set(commands()))


def test_every_command_has_a_short_form() -> None:
    modules = {module for module, _ in NAMED}
    assert modules - SHORT_FORMS.keys() - EXEMPT.keys() == set()


def test_every_benchmark_has_a_short_form() -> None:
    programs = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
        for file in (ROOT / "benchmarks").rglob("*.py")
        if 'if __name__ == "__main__":' in file.read_text()
    }
    parts = {"benchmarks.calls.peer", "benchmarks.dashboard_pictures"}
    assert programs - parts - SHORT_FORMS.keys() == set()


@pytest.mark.slow
@pytest.mark.exhaustive
@pytest.mark.parametrize(("module", "options"), SHORT_FORMS.items(), ids=SHORT_FORMS)
def test_a_command_runs_to_its_end(module: str, options: str, tmp_path: Path) -> None:
    words = shlex.split(options.format(folder=tmp_path))
    # else NiceGUI takes the dashboard for a part of this test
    environment = {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"}
    done = subprocess.run(
        [sys.executable, "-m", module, *words],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    busy = BUSY.get(module, "no reason") in done.stdout
    assert done.returncode == busy, done.stdout[-2000:] + done.stderr[-4000:]
    assert done.stdout
    if "--json" in words:
        assert isinstance(json.loads(done.stdout), Mapping | list)
