"""Several clients move components of one container at once: nothing is lost by that.

While one is moved, the target of another is imported and configured beside it.
"""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from examples.demo.waiting import measures
from poise.session.running_robots.running import RolledBack, Running
from tests.command import robot_up
from tests.session.emulated_robot import written
from tests.waiting import LONG, wait_long

pytestmark = [
    pytest.mark.slow,
    pytest.mark.exhaustive,
    pytest.mark.timeout(2 * LONG),
]

CODE = Path(__file__).parents[2].joinpath("examples/counted/counted.py").read_text()
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 0.9, memory: 1 GiB}}
  right: {{cpu: 0.9, memory: 1 GiB}}
architectures:
  counted:
    function: counting
    home: left
    components:
      source: {{implementation: "at_once:Source", cpu: 10%}}
      passer: {{implementation: "at_once:Passer", cpu: 10%, parameters: {{ballast: 9}}}}
      sink: {{implementation: "at_once:Sink", cpu: 10%}}
    connectors:
      - {{between: [source.numbers, passer.numbers], limit: 5 s}}
      - {{between: [passer.passed, sink.passed], limit: 5 s}}
      - {{between: [source.doubles, passer.doubles], limit: 5 s}}
tasks:
  count: {{actions: [{{name: count, functions: [counting]}}]}}
"""
TIMES = 8


def test_moves_at_once_lose_nothing(tmp_path: Path) -> None:
    begins = "def configure(self) -> None:\n"
    code = CODE.replace(begins, f"{begins}        time.sleep(0.1)\n")
    code = code.replace("from typing", "import time\nfrom typing")
    file = written(tmp_path, "at-once", "at_once", code, ROBOT)
    with robot_up(file, "--no-adapt"):
        running = Running(file.read_text().split()[1])
        committed: list[str] = []

        def move(component: str) -> None:
            for _ in range(TIMES):
                here = running.status().placement[component]
                there = "left" if here == "right" else "right"
                try:
                    running.move(component, there)
                    committed.append(component)
                except RolledBack:  # a busy machine; nothing is lost by that, either
                    pass

        names = ("source", "passer", "sink")
        threads = [threading.Thread(target=move, args=[name]) for name in names]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LONG)
        assert {*committed} == {*names}
        # what moved last tells its measures with its next report
        wait_long(lambda: "received" in measures(running))
        received = measures(running)["received"]
        wait_long(lambda: measures(running)["received"] > received + 100)
        counts = measures(running)
    wrong = {name: counts[name] for name in ("lost", "doubled", "reordered", "failed")}
    assert not any(wrong.values()), wrong
