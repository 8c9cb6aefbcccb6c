"""What the README says a newcomer should type works as it stands there."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command import Poise

ROOT = Path(__file__).parents[2]
HELLO = ROOT / "examples/hello"

Write = Callable[[str, Path], list[str]]


def test_the_readme_shows_the_hello_example(write_files: Write, tmp_path: Path) -> None:
    assert write_files("README.md", tmp_path) == ["hello.py", "robot.yaml"]
    for name in ("hello.py", "robot.yaml"):
        assert (tmp_path / name).read_text() == (HELLO / name).read_text()


def test_the_page_on_cpp_shows_its_example(write_files: Write, tmp_path: Path) -> None:
    names = write_files("docs/cpp-components.md", tmp_path)
    assert names == ["CMakeLists.txt", "pilot.cpp"]
    for name in names:
        shown, used = tmp_path / name, ROOT / "examples/cpp" / name
        assert shown.read_text() == used.read_text()


def test_the_first_component_has_20_lines_at_most() -> None:
    code = (HELLO / "hello.py").read_text().splitlines()
    assert len([line for line in code if line.strip()]) <= 20


@pytest.mark.slow
def test_the_first_component_runs(
    write_files: Write, poise: Poise, tmp_path: Path
) -> None:
    write_files("README.md", tmp_path)
    assert poise("check", "robot.yaml").returncode == 0
    assert poise("plan", "robot.yaml", "--task", "greet").returncode == 0
    run = poise("run", "robot.yaml", "--task", "greet", "--for", "3s")
    # a machine too busy for the emulation makes the run invalid
    if "invalid run:" not in run.stdout:
        assert run.returncode == 0
        assert "printer has 20" in run.stdout + run.stderr


@pytest.mark.slow
def test_the_oven_of_the_component_guide_runs(
    write_files: Write, poise: Poise, tmp_path: Path
) -> None:
    names = write_files("docs/writing-components.md", tmp_path)
    code = ["oven.py", "sensing.py", "control.py"]
    assert names == [*code, "robot.yaml", "test_control.py"]
    run = poise("run", "robot.yaml", "--task", "bake", "--for", "3s", "--json")
    components = {c["name"]: c for c in json.loads(run.stdout)["components"]}
    assert all(component["errors"] == 0 for component in components.values())
    # 0.05/degree from 20 degrees asks for all of the heater's 2000 W
    assert components["controller"]["measures"]["watts"]["maximum"] == 2000


@pytest.mark.slow
def test_the_guides_own_test_passes(write_files: Write, tmp_path: Path) -> None:
    write_files("docs/writing-components.md", tmp_path)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    run = subprocess.run(
        [*command, "test_control.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "1 passed" in run.stdout, run.stdout
