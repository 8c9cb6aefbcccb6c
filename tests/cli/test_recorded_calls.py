"""Calls between architectures are recorded, and played to who is measured alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.estimate import profiles as profile_file
from poise.runtime.component.implementation import find_type
from poise.runtime.connectors.interface import methods
from poise.wire.recording_file import inputs_of
from tests.command import Poise

ROBOT = """\
robot: asked
computers:
  main: {cpu: 1, memory: 1 GiB}
architectures:
  asking:
    function: asking
    components:
      one: {implementation: "asked:Asker", cpu: 1%, memory: 30 MiB}
      two: {implementation: "asked:Asker", cpu: 1%, memory: 30 MiB}
  knowing:
    function: knowing
    components: {sage: {implementation: "asked:Sage", cpu: 1%, memory: 30 MiB}}
connectors:
  - {between: [one.questions, sage.questions]}
  - {between: [two.questions, sage.questions]}
tasks: {ask: {actions: [{name: ask, functions: [asking, knowing]}]}}
profile: profile.yaml
"""
CODE = """
from poise import Component, Provided, Required, every, oneway

class Questions:
    def ask(self, what: str, number: int) -> str:
        raise NotImplementedError

    @oneway
    def tell(self, what: str) -> None:
        raise NotImplementedError

class Asker(Component):
    questions: Required[Questions]

    @every(0.05)
    def think(self) -> None:
        self.questions.ask("why" * 100, number=7)
        self.questions.tell("so" * 50)

class Sage(Component):
    questions: Provided[Questions]

    def ask(self, what: str, number: int) -> str:
        return what[:number]

    def tell(self, what: str) -> None:
        self.measure("told", len(what))
"""


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_calls_are_recorded_and_played(tmp_path: Path, poise: Poise) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "asked.py").write_text(CODE)
    run = poise(
        "run", "robot.yaml", "--task", "ask", "--for", "3s", "--record", "a.mcap"
    )
    said = run.stdout + run.stderr
    assert "calls of one.questions, two.questions to a.mcap" in said, said

    inputs = inputs_of(tmp_path / "a.mcap")
    assert {each.source for each in inputs} == {"one.questions", "two.questions"}
    assert [each.at for each in inputs] == sorted(each.at for each in inputs)
    interface: type = find_type("asked:Questions", str(tmp_path))
    known = methods(interface)
    by_name = {known[each.tag or 0].name: each for each in inputs}
    arguments = {
        name: known[each.tag or 0].arguments.decode(each.body, memoryview(each.buffers))
        for name, each in by_name.items()
    }
    assert arguments == {"ask": ("why" * 100, 7), "tell": ("so" * 50,)}
    ask = by_name["ask"]
    assert known[ask.tag or 0].result.decode(ask.result, memoryview(b"")) == "whywhyw"
    assert by_name["tell"].result == b""

    (tmp_path / "robot.yaml").write_text(f"{ROBOT}workload: {{recording: a.mcap}}\n")
    done = poise(
        *("profile", "robot.yaml", "--architecture", "knowing", "--for", "2s"),
        *("--warm-up", "1s", "--repeat", "1"),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    profile = profile_file.read(tmp_path / "profile.yaml")
    assert set(profile.components) == {"sage"}
    played = profile.connectors["two.questions-sage.questions"]
    # both at 20 Hz but for the pause after each round; the machine may be late
    assert 0 < played.calls < 45
    assert 0 < played.messages < 45
