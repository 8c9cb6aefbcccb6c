"""A simulated world ends with all that it started, and its last words are heard."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from poise.errors import RobotError, RunError
from poise.model.robot import Robot, Simulator
from poise.session.launch.start import SimulatorProcess, world_of
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

SCRIPT = """\
trap 'echo "{\\"steps\\": 7}"; exit' TERM
sleep 1000 &
echo ready
echo $! > helper
wait
"""
ENDED = "echo ready; echo '{\"steps\": 3}'"


def robot(script: str, folder: Path) -> Robot:
    (folder / "world.sh").write_text(script)
    simulator = Simulator(command=("sh", "world.sh"))
    return Robot(name="r", folder=str(folder), computers=(), simulator=simulator)


def is_running(pid: int) -> bool:
    with contextlib.suppress(OSError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state != "Z"
    return False


def test_it_ends_with_what_it_started(tmp_path: Path) -> None:
    with world_of(robot(SCRIPT, tmp_path), tmp_path) as world:
        assert world is not None
        assert not world.has_ended()
        wait_until((tmp_path / "helper").exists)
        wait_until(lambda: (tmp_path / "helper").read_text().endswith("\n"))
        helper = int((tmp_path / "helper").read_text())
        assert is_running(helper)
        assert world.result() == {"steps": 7}
    wait_until(lambda: not is_running(helper))


def test_one_that_ended_by_itself_is_heard(tmp_path: Path) -> None:
    with world_of(robot(ENDED, tmp_path), tmp_path) as world:
        assert isinstance(world, SimulatorProcess)
        wait_until(world.has_ended)
        assert world.result() == {"steps": 3}
        assert world.has_ended()


def test_one_that_is_not_ready_is_refused(tmp_path: Path) -> None:
    said = pytest.raises(RunError, match="said 'no' instead of 'ready'")
    with said, world_of(robot("echo no", tmp_path), tmp_path):
        pass


def test_one_that_cannot_start_is_named(tmp_path: Path) -> None:
    nothing = Robot(
        name="r",
        folder=str(tmp_path),
        computers=(),
        simulator=Simulator(command=("./nothing",)),
    )
    said = pytest.raises(RobotError, match=r"simulator './nothing' cannot start")
    with said, world_of(nothing, tmp_path):
        pass
