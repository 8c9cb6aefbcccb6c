"""A robot outlives its manager, and another one takes it over."""

from __future__ import annotations

import json
import os
import signal
import socket
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from poise.emulate import probe_host
from tests.command import robot_up, run_poise
from tests.runtime.conftest import free_port
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

HELLO = Path(__file__).parents[2] / "examples" / "hello"
NAME = f"outlived{os.getpid()}"


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a robot file; end what the test left of the robot."""
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for path in HELLO.glob("*.py"):
        (tmp_path / path.name).write_text(path.read_text())
    file = tmp_path / "robot.yaml"
    text = (HELLO / "robot.yaml").read_text()
    file.write_text(text.replace("robot: hello", f"robot: {NAME}"))
    yield file
    run_poise("stop", "--robot", NAME)
    run_poise("emulate", "stop", "--robot", NAME)


def status() -> dict[str, Any]:
    done = run_poise("status", "--robot", NAME, "--json")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def containers(answer: dict[str, Any]) -> set[int]:
    """Return the processes of all containers."""
    computers = answer["computers"].values()
    return {container["pid"] for each in computers for container in each["containers"]}


def test_a_killed_manager_is_succeeded_by_one_that_touches_nothing(
    file: Path, tmp_path: Path
) -> None:
    first = run_poise("up", file, "--detach")
    assert first.returncode == 0, first.stderr
    assert "stay up until `poise emulate stop`" in first.stdout
    before = status()
    os.kill(before["manager"]["pid"], signal.SIGKILL)
    second = run_poise("up", "--detach", file)
    assert second.returncode == 0, second.stderr
    after = status()
    assert after["manager"]["pid"] != before["manager"]["pid"]
    assert containers(after) == containers(before)
    assert after["placement"] == before["placement"]
    wait_long(lambda: not status()["deviations"])
    log = (tmp_path / "poise" / f"{NAME}.log").read_text()
    assert "going on with 2 components" in log

    refused = run_poise("up", "--detach", file)
    assert refused.returncode == 2
    assert "runs already" in refused.stderr


def test_arguments_hold_for_the_emulated_computers_too(file: Path) -> None:
    text = file.read_text().replace("left: {cpu: 0.5", "left: {cpu: $(cores)")
    file.write_text(f"arguments: {{cores: 0.5}}\n{text}")
    done = run_poise("up", "--detach", file, "--set", "cores=0.4")
    assert done.returncode == 0, done.stderr
    assert status()["capacities"]["left"]["cpu"] == pytest.approx(0.4)


def test_a_component_that_was_edited_restarts_alone(file: Path) -> None:
    assert run_poise("up", "--detach", file).returncode == 0
    before = status()
    os.kill(before["manager"]["pid"], signal.SIGKILL)
    text = file.read_text()
    file.write_text(text.replace("hello:Printer", "other:Printer"))
    (file.parent / "other.py").write_text((file.parent / "hello.py").read_text())
    done = run_poise("up", "--detach", file)
    assert done.returncode == 0, done.stderr
    after = status()
    assert len(containers(after) & containers(before)) == 1
    wait_long(lambda: not status()["deviations"])


def test_a_manager_that_is_replaced_leaves_the_robot_and_says_by_whom(
    file: Path,
) -> None:
    assert run_poise("up", "--detach", file).returncode == 0
    os.kill(status()["manager"]["pid"], signal.SIGKILL)
    port = free_port()
    with robot_up(file, "--metrics", port) as first:
        before = status()
        done = run_poise("up", "--detach", "--take-over", "--metrics", port, file)
        assert done.returncode == 0, done.stderr
        said = first.communicate()[0]
        assert first.returncode == 3
        assert "has taken over the robot, which keeps running" in said
        assert containers(status()) == containers(before)
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=20) as told:
        assert b"poise_timer_releases_total{" in told.read()


def test_nothing_is_started_where_metrics_cannot_be_served(file: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        refused = run_poise("up", file, "--metrics", other.getsockname()[1])
    assert refused.returncode == 1
    assert "metrics cannot be served" in refused.stderr
    assert "starting" not in refused.stdout


def test_a_computer_that_is_lost_meanwhile_keeps_no_manager_from_the_rest(
    file: Path,
) -> None:
    assert (
        run_poise("up", "--detach", "--placement", "round-robin", file).returncode == 0
    )
    before = status()
    assert set(before["placement"].values()) == {"left", "right"}
    os.kill(before["manager"]["pid"], signal.SIGKILL)
    assert run_poise("emulate", "crash", "right", "--robot", NAME).returncode == 0
    done = run_poise("up", "--detach", "--take-over", file)
    assert done.returncode == 0, done.stderr
    wait_long(lambda: set(status()["placement"].values()) == {"left"})
    assert "right" in status()["out_of_reach"]


def test_an_error_of_a_detached_start_is_said(file: Path) -> None:
    done = run_poise("up", "--detach", "--task", "nothing", file)
    assert done.returncode == 2
    assert "has no task 'nothing'" in done.stderr
    assert NAME not in run_poise("emulate", "list").stdout
