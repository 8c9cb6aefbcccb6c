"""`poise check` as people and scripts run it."""

import contextlib
import json
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import called
from tests.waiting import LONG

ROOT = Path(__file__).parents[2]
POISE = "import sys; from poise.cli.main import main; sys.exit(main())"


def started(before: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a process that does something else before."""
    return subprocess.run(
        [sys.executable, "-c", before + POISE, *words],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )


@pytest.fixture
def bad_file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text("robot: r\ncomputers: {main: {cpu: 1 kB, memory: -1}}\n")
    return path


@pytest.mark.slow
def test_says_that_a_right_file_has_no_problems() -> None:
    done = called(["check", str(ROOT / "examples/paper/robot.yaml")])
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("robot.yaml: no problems\n")


@pytest.mark.slow
def test_says_that_the_recording_of_a_workload_is_not_there(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples/hello", tmp_path, dirs_exist_ok=True)
    path = tmp_path / "robot.yaml"
    path.write_text(path.read_text() + "workload: {recording: drive.mcap}\n")
    assert (
        "recording 'drive.mcap' is not there yet" in called(["check", str(path)]).stdout
    )
    (tmp_path / "drive.mcap").touch()
    assert called(["check", str(path)]).stdout == f"{path}: no problems\n"


@pytest.mark.slow
def test_a_profile_that_cannot_be_read_is_a_problem(tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    main = "{cpu: 1, memory: 1 GiB}"
    text = f"robot: r\ncomputers: {{main: {main}}}\nprofile: profile.yaml\n"
    robot.write_text(text)
    assert called(["check", str(robot)]).returncode == 0  # it is written later
    (tmp_path / "profile.yaml").mkdir()
    done = called(["check", str(robot)])
    assert done.returncode == 1
    assert done.stderr.startswith(f"{robot}:3:1: profile ")
    assert "cannot be read: Is a directory." in done.stderr


@pytest.mark.slow
def test_a_terminal_shows_that_it_goes_on() -> None:
    ours, theirs = pty.openpty()
    words = ["check", str(ROOT / "examples/hello/robot.yaml")]
    with subprocess.Popen(
        [sys.executable, "-m", "poise", *words], stdout=theirs, stderr=theirs
    ):
        os.close(theirs)
        said = b""
        with contextlib.suppress(OSError):  # its end
            while part := os.read(ours, 4096):
                said += part
    os.close(ours)
    assert b"checking" in said
    assert b"no problems" in said


@pytest.mark.slow
def test_tells_every_problem_with_its_place_and_exits_1(bad_file: Path) -> None:
    done = called(["check", str(bad_file)])
    first, second, last = done.stderr.splitlines()
    assert first.startswith(f"{bad_file}:2:20: computers.main.cpu: '1 kB'")
    assert second.startswith(f"{bad_file}:2:31: computers.main.memory: '-1'")
    assert last == f"{bad_file}: 2 problems"
    assert (done.returncode, done.stdout) == (1, "")


@pytest.mark.slow
def test_json_is_for_scripts(bad_file: Path) -> None:
    done = called(["check", str(bad_file), "--json"])
    report = json.loads(done.stdout)
    assert report["ok"] is False
    assert done.returncode == 1
    assert [set(p) for p in report["problems"]] == [
        {"file", "line", "column", "message"}
    ] * 2
    assert (report["problems"][0]["line"], report["problems"][0]["column"]) == (2, 20)


@pytest.mark.slow
def test_code_is_checked_when_the_file_is_right(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: r\ncomputers: {main: {cpu: 1, memory: 1}}\n"
        "architectures: {x: {function: f, components: {\n"
        '  a: {implementation: "nowhere.at:All"}}}}\n'
    )
    done = called(["check", str(path)])
    assert done.returncode == 1
    assert f"{path}:4:7: there is no module 'nowhere'" in done.stderr


@pytest.mark.slow
def test_code_that_ends_its_process_is_a_problem_and_json_stays_json(
    tmp_path: Path,
) -> None:
    (tmp_path / "bad.py").write_text("import os\nprint('hello')\nos._exit(0)\n")
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: r\ncomputers: {main: {cpu: 1, memory: 1}}\n"
        "architectures: {x: {function: f, components: {\n"
        '  a: {implementation: "bad:Bad"}}}}\n'
    )
    done = called(["check", str(path), "--json"])
    (problem,) = json.loads(done.stdout)["problems"]
    assert (problem["line"], problem["column"], done.returncode) == (4, 7, 1)
    assert "module 'bad' ended the process with exit code 0" in problem["message"]


@pytest.mark.slow
def test_prints_the_schema() -> None:
    done = called(["check", "--schema"])
    assert done.returncode == 0
    assert json.loads(done.stdout)["title"] == "Poise robot file"


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["check"], ["chek"], ["check", "--jsn", "x"]])
def test_wrong_use_exits_2(arguments: list[str]) -> None:
    done = called(arguments)
    assert done.returncode == 2
    assert done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_missing_file_is_a_problem_without_a_traceback(tmp_path: Path) -> None:
    done = called(["check", str(tmp_path / "none.yaml")])
    assert done.returncode == 1
    assert "none.yaml: does not exist" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_an_interrupt_ends_with_130() -> None:
    interrupt = (
        "import poise.cli.robot_file_command as c\n"
        "def stop(*_):\n    raise KeyboardInterrupt\n"
        "c.check = stop\n"
    )
    done = started(interrupt, "check", "robot.yaml")
    assert (done.returncode, done.stderr) == (130, "")


ALONE = """
import importlib, os, sys
import msgspec, rich.console, rich.table, typer, yaml, zenoh
from poise.cli.command_table import COMMANDS

for where in sorted({where for where, _ in COMMANDS.values()}):
    if not (child := os.fork()):
        importlib.import_module(f"poise.cli.{where}_command")
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        sys.exit(where)
"""


@pytest.mark.slow
def test_every_command_can_be_loaded_alone() -> None:
    """Most tests call commands in their own process, where much is loaded before."""
    done = subprocess.run(
        [sys.executable, "-c", ALONE],
        stderr=subprocess.PIPE,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_help_loads_nothing_heavy() -> None:
    done = started(
        "import atexit, sys; atexit.register(lambda: print("
        "'loaded', [m for m in ('zenoh', 'numpy', 'ortools') if m in sys.modules]))\n",
        "--help",
    )
    assert "loaded []" in done.stdout
