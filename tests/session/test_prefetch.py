"""The next action is prepared by real processes while another one runs."""

from __future__ import annotations

from pathlib import Path

import pytest

import poise
from poise.session.running_robots.running import Running, Status
from tests.session.emulated_robot import written
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

CODE = """
import os
from poise import Component, Published, every

class Able(Component):
    ended: Published[bool]

    @every(0.05)
    def look(self):
        if os.path.exists(os.path.join(self.parameters["folder"], self.name)):
            self.ended.publish(True)

class Broken(Able):
    def configure(self):
        raise LookupError("no such map")
"""
ROBOT = """
robot: {name}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  see: {{function: seeing, components: {{eyes: {{
    implementation: "prefetched:Able", cpu: 5%, memory: 30 MiB, only: [left],
    parameters: {{folder: "{folder}"}}}}}}}}
  drive: {{function: driving, components: {{wheels: {{
    implementation: "prefetched:Able", cpu: 5%, memory: 30 MiB, only: [right],
    parameters: {{folder: "{folder}"}}}}}}}}
  grasp: {{function: grasping, components: {{hand: {{
    implementation: "prefetched:Broken", cpu: 5%, memory: 30 MiB}}}}}}
tasks:
  fetch:
    actions:
      - {{name: find, functions: [seeing], ends: eyes.ended}}
      - {{name: go, functions: [driving], ends: wheels.ended}}
      - {{name: take, functions: [grasping], ends: hand.ended}}
"""


def test_the_next_action_is_prepared_and_one_that_cannot_be_hurts_nobody(
    tmp_path: Path,
) -> None:
    file = written(tmp_path, "prefetch", "prefetched", CODE, ROBOT)
    journal = tmp_path / "journal.jsonl"

    def said(kind: str, text: str) -> bool:
        entries = poise.read_journal(journal)
        return any(e.kind == kind and text in e.what for e in entries)

    with poise.up(poise.load(file), journal=journal) as running:
        wait_long(lambda: said("done", "'wheels' prepared within"))
        status = running.status()
        assert status.prefetch.prepared == {"wheels": "right"}
        assert "wheels" not in status.placement
        # the kernel would end it first
        assert score_of(status, "right", "wheels") == 1000
        assert score_of(status, "left", "eyes") == 500
        (tmp_path / "eyes").touch()
        wait_long(lambda: action_of(running) == "go")
        wait_long(lambda: running.status().prefetch.hit.count == 1)
        after = running.status()
        assert after.prefetch.miss.count == 0
        assert pid_of(after, "right", "wheels") == pid_of(status, "right", "wheels")
        wait_long(lambda: said("failed", "component 'hand' cannot be prepared on"))
        assert running.tasks.show("fetch").state == "going"
        (tmp_path / "wheels").touch()
        report = running.tasks.wait("fetch", 60.0)
        assert report.state == "failed"
        assert "LookupError: no such map" in report.why


def action_of(running: Running) -> str:
    (action,) = running.tasks.show("fetch").actions
    return action.name


def pid_of(status: Status, computer: str, component: str) -> int:
    return next(
        container.pid
        for container in status.computers[computer].containers
        if any(each.name == component for each in container.components)
    )


def score_of(status: Status, computer: str, component: str) -> int:
    pid = pid_of(status, computer, component)
    return int(Path(f"/proc/{pid}/oom_score_adj").read_text())
