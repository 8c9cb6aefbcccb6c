"""Whatever goes wrong in a run is said, and the exit code agrees."""

from __future__ import annotations

import json
import signal
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from tests.command import POISE
from tests.waiting import LONG

pytestmark = pytest.mark.slow

CODE = """
import os, signal, threading
from poise import Component, Message, Published, every, subscribed

class Number(Message):
    value: int

class Source(Component):
    numbers: Published[Number]

    @every(0.01)
    def tick(self):
        self.numbers.publish(Number(1))

class Quick(Component):
    @subscribed(keep=1000)
    def numbers(self, message: Number):
        pass

class Grumbling(Component):
    @every(0.05)
    def tick(self):
        raise LookupError("no map")

    @every(0.1)
    def tock(self):
        raise ValueError("no pose")

class Dying(Component):
    @every(0.1)
    def tick(self):
        mark = __file__ + ".died"
        if not os.path.exists(mark):
            open(mark, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)

class Broken(Component):
    def activate(self):
        raise LookupError("no arm")

class Hanging(Component):
    @every(0.1, deadline=0.05)
    def tick(self):
        threading.Event().wait()
"""
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  feed:
    function: feed
    home: left
    components: {{source: {{implementation: "parts:Source", cpu: 5%}}}}
  work:
    function: work
    home: right
    components:
{components}
  other: {{function: work, home: right, components: {{other: {quick}}}}}
connectors:
  - between: [source.numbers, quick.numbers]
  - between: [source.numbers, other.numbers]
tasks:
  all: {{actions: [{{name: all, functions: [{functions}]}}]}}
"""
QUICK = '{implementation: "parts:Quick", cpu: 5%}'


def robot(folder: Path, *parts: str, functions: str = "feed, work") -> Path:
    """Write a robot whose function `work` has two alternatives."""
    (folder / "parts.py").write_text(CODE)
    lines = ["      quick: " + QUICK]
    lines += [
        f'      {part.lower()}: {{implementation: "parts:{part}", cpu: 5%}}'
        for part in parts
    ]
    text = ROBOT.format(
        name=f"fails{folder.name[-8:]}".replace("_", "").lower(),
        components="\n".join(lines),
        quick=QUICK,
        functions=functions,
    )
    (folder / "robot.yaml").write_text(text)
    return folder / "robot.yaml"


def start(file: Path, *options: str) -> subprocess.Popen[str]:
    argv = [*POISE, "run", str(file), "--json", *options]
    return subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def run(file: Path, *options: str) -> tuple[int, dict[str, Any]]:
    with start(file, *options) as process:
        out, said = process.communicate(timeout=LONG)
    assert out, said
    return process.returncode, json.loads(out)


def messages(report: dict[str, Any]) -> dict[str, dict[str, int]]:
    """Return connector -> end -> messages that this end counted."""
    found: dict[str, dict[str, int]] = defaultdict(dict)
    for end in report["connectors"]:
        found[end["name"]][end["end"]] = end["messages"]
    return found


@pytest.mark.parametrize("placement", ["auto", "static"])
def test_one_alternative_runs_and_all_that_was_sent_is_in_the_final_counts(
    tmp_path: Path, placement: str
) -> None:
    code, report = run(robot(tmp_path), "--for", "1s", "--placement", placement)
    assert len(report["placement"].keys() & {"quick", "other"}) == 1
    (counts,) = messages(report).values()
    assert set(counts) == {"source", "target"} or set(counts) == {"both"}
    assert len(set(counts.values())) == 1
    assert min(counts.values()) > 0
    assert report["lost"] == {}
    assert report["silent"] == []
    assert code == (1 if report["invalid"] else 0)


def test_an_architecture_that_does_not_start_is_learned_and_the_next_run_takes_another(
    tmp_path: Path,
) -> None:
    file = robot(tmp_path, "Broken")
    text = file.read_text()
    file.write_text(text.replace("other: {function", "other: {quality: 0.9, function"))
    code, failed = run(file, "--for", "1s")
    assert code == 1
    assert "component 'broken' on " in failed["error"]
    _, report = run(file, "--for", "1s")
    assert set(report["placement"]) == {"source", "other"}


def test_every_distinct_error_and_a_hung_handler_are_in_the_report(
    tmp_path: Path,
) -> None:
    file = robot(tmp_path, "Grumbling", "Hanging")
    code, report = run(file, "--for", "2s", "--placement", "static")
    assert code == 1
    errors = {error["where"]: error for error in report["errors"]}
    assert errors.keys() == {"tick", "tock"}
    assert {error["component"] for error in errors.values()} == {"grumbling"}
    assert {error["computer"] for error in errors.values()} == {"right"}
    assert errors["tick"]["count"] > errors["tock"]["count"] > 0
    assert "LookupError: no map" in errors["tick"]["text"]
    assert errors["tick"]["first"] > 1e9
    (hung,) = report["hung"]
    assert (hung["component"], hung["handler"]) == ("hanging", "tick")
    assert hung["seconds"] > 0.0


def test_a_container_that_ended_is_in_the_report(tmp_path: Path) -> None:
    file = robot(tmp_path, "Dying")
    code, report = run(file, "--for", "2s", "--placement", "static")
    assert code == 1
    (fault,) = report["faults"]
    assert "was killed by SIGKILL" in fault["message"]


def test_ctrl_c_ends_a_run_with_its_report(tmp_path: Path) -> None:
    with start(robot(tmp_path), "--for", "100s") as process:
        assert process.stderr is not None
        assert any("running task" in line for line in process.stderr)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=LONG)
    assert process.returncode == 128 + signal.SIGINT
    report = json.loads(out)
    assert report["interrupted"]
    assert report["components"]
    assert report["seconds"] < 50


def test_a_simulator_without_a_result_and_a_port_that_got_nothing_are_said(
    tmp_path: Path,
) -> None:
    file = robot(tmp_path, functions="work")
    simulator = "simulator: {command: [sh, -c, 'echo ready; exec sleep 100']}\n"
    file.write_text(file.read_text() + simulator)
    code, report = run(file, "--for", "0.5s")
    assert code == 1
    assert "the simulator ended without a result" in report["invalid"]
    assert report["simulation"] == {}
    silent = report["silent"][0]
    assert silent["port"] in {"quick.numbers", "other.numbers"}
    assert "component 'source', which publishes to it, does not run" in silent["reason"]
