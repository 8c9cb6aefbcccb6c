"""What is written at the end of a command can be written, or it does not begin."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from poise.cli.command_table import build
from poise.errors import UsageError
from poise.model import load
from poise.session.folders import to_write
from tests.command import run_poise

pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"


def test_what_is_there_stays_and_what_is_not_is_not_made(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_text("kept")
    assert (to_write(old), to_write(new), to_write(None)) == (old, new, None)
    assert old.read_text() == "kept"
    assert not new.exists()


@pytest.mark.parametrize(
    "words",
    [
        ["run", "FILE", "--task", "greet", "--record", "nowhere/it"],
        ["run", "FILE", "--task", "greet", "--report", "robot.yaml"],
        ["up", "FILE", "--record", "nowhere/it"],
        ["up", "FILE", "--journal", "nowhere/it"],
        ["up", "FILE", "--journal", "robot.yaml"],
        ["profile", "show", "FILE", "--plot", "nowhere/it.svg"],
        ["recording", "export", "FILE", "--to", "nowhere/it.csv"],
        ["draw", "FILE", "-o", "nowhere/it.svg"],
        ["ros2", "export", "FILE", "-o", "robot.yaml"],
    ],
    ids=lambda words: f"{words[0]} {words[-2]} {words[-1]}",
)
def test_a_command_that_could_not_write_its_file_names_it(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(HELLO, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    words = ["robot.yaml" if word == "FILE" else word for word in words]
    result = CliRunner().invoke(build(words), words)
    assert isinstance(result.exception, UsageError)
    assert words[-1] in str(result.exception)
    assert "emulating" not in result.stdout


@pytest.mark.parametrize("command", ["profile", "calibrate"])
def test_nothing_is_measured_that_could_not_be_kept(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(HELLO, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".poise").write_text("in the way")
    result = CliRunner().invoke(build([command]), [command, "robot.yaml"])
    assert isinstance(result.exception, UsageError)
    said = str(result.exception)
    assert "profiles.sqlite cannot store profiles: " in said
    assert said.endswith(".poise: File exists")


@pytest.mark.parametrize("command", ["status", "stop"])
def test_two_ways_to_name_a_robot_are_refused(command: str) -> None:
    done = run_poise(command, "--robot", "other", "--file", HELLO / "robot.yaml")
    assert done.returncode == 2
    assert "not both" in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--name", "my robot"], "--name 'my robot' is not a name: a letter of a-z"),
        (["--computer", "a.b:cpu=2,memory=1GiB"], "--computer 'a.b' is not a name"),
        (["--computer", "arm:gpu=2"], "--computer arm: say its cpu and its memory"),
        (["--computer", "arm:cpu=2,memory=0"], "--computer arm: say its cpu and its"),
        (["--computer", "arm:cpu=2,memory=1GiB"] * 2, "--computer arm is there twice"),
    ],
)
def test_ros_2_is_not_watched_for_what_no_robot_file_can_have(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run_poise("ros2", "import", "--for", "1s", *words)
    assert done.returncode == 2
    assert says in done.stderr
    assert "watching" not in done.stderr


def test_limits_are_times_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # where no robot runs
    for words, option in {
        ("plan", str(tmp_path / "none.yaml")): "--budget",
        ("call", "valve.watering", "pour"): "--limit",
    }.items():
        for time, is_one in {"500ms": True, "0.5": True, "soon": False}.items():
            done = run_poise(*words, option, time)
            assert done.returncode
            says = f"{option} {time}: '{time}' is not a time such as 200 ms"
            assert (says in done.stderr) == (not is_one)


@pytest.mark.parametrize("words", [["record"], ["hz", "counter.count"]])
def test_a_time_is_said_as_everywhere(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # where no robot runs
    for time, says in {
        "2 min": "no robot runs here",
        "2": "no robot runs here",
        "soon": "--for soon: 'soon' is not a time such as 200 ms",
        "0s": "--for 0s: ",
    }.items():
        done = run_poise(*words, "--for", time)
        assert done.returncode == 2
        assert says in done.stderr


def test_a_task_that_is_named_twice_is_no_task_that_runs_already() -> None:
    done = run_poise("up", HELLO / "robot.yaml", *2 * ["--task", "greet"])
    assert done.returncode == 2
    assert done.stderr == "task 'greet' is named twice; name each task once\n"
    assert not done.stdout


def test_a_drawing_of_no_placement_is_refused() -> None:
    done = run_poise("draw", HELLO / "robot.yaml", "--compare", ",", "-o", "-")
    assert done.returncode == 2
    assert "',' names no placement, as static,auto" in done.stderr


def test_a_drawing_without_a_task_is_of_all_functions_and_says_so() -> None:
    tasks = HELLO.with_name("tasks") / "robot.yaml"
    drawn = run_poise("draw", tasks, "--placement", "auto", "-o", "-").stdout
    first = load(tasks).tasks[0].name
    of_first = run_poise(
        "draw", tasks, "--placement", "auto", "--task", first, "-o", "-"
    ).stdout
    assert drawn.count("«component»") > of_first.count("«component»")
    said = " ".join(run_poise("draw", "-h").stdout.replace("│", " ").split())
    assert "The task. Default: all functions." in said


@pytest.mark.parametrize("text", ["vision", "vision:cpu=x", "vision:cpu=1,cpu=2"])
def test_a_computer_that_is_no_computer_is_named_by_its_own_option(
    text: str, tmp_path: Path
) -> None:
    words = ["ros2", "import", "--computer", text, "-o", str(tmp_path / "robot.yaml")]
    result = CliRunner().invoke(build(words), words)
    assert isinstance(result.exception, UsageError)
    assert str(result.exception).startswith(f"--computer '{text}': ")
