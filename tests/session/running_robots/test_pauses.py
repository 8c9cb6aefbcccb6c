"""What components publish until their task pauses arrives."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import poise
from poise.manage.tasks.switch import PATIENCE
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.exhaustive, pytest.mark.slow, pytest.mark.timeout(LONG)]

CODE = '''
"""One sends numbers, the other writes down what comes."""

from pathlib import Path

from poise import Component, Message, Published, every, subscribed


class Number(Message):
    value: int


class Source(Component):
    number: Published[Number]
    value = 0

    @every(0.005)
    def tick(self) -> None:
        self.value += 1
        with Path("sent").open("a") as file:
            file.write(f"{self.value}\\n")
        self.number.publish(Number(self.value))


class Sink(Component):
    @subscribed(block=50)
    def number(self, number: Number) -> None:
        with Path("taken").open("a") as file:
            file.write(f"{number.value}\\n")
'''

ROBOT = """
robot: pausing
computers:
  left: {cpu: 0.5, memory: 512 MiB}
  right: {cpu: 0.5, memory: 512 MiB}
links:
  - {between: [left, right], bandwidth: 100 Mbit/s, latency: 1 ms}
architectures:
  count:
    function: counting
    components:
      source: {implementation: "pausing:Source", only: [left]}
      sink: {implementation: "pausing:Sink", only: [right]}
    connectors:
      - {between: [source.number, sink.number]}
tasks: {count: {actions: [{name: count, functions: [counting]}]}}
"""


def test_what_is_published_until_a_task_pauses_arrives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pausing.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    last: list[int] = []  # before each pause that did not take too long
    with poise.up(poise.load(tmp_path / "robot.yaml"), "count") as running:
        for _ in range(10):
            had = len(numbers("taken"))
            wait_long(lambda: len(numbers("taken")) > had + 20)  # noqa: B023, at once
            since = time.monotonic()
            running.tasks.pause("count")
            if time.monotonic() - since < PATIENCE:
                last.append(numbers("sent")[-1])
            running.tasks.resume("count")
        wait_long(lambda: numbers("taken")[-1] > last[-1])
    taken = numbers("taken")
    assert taken == sorted(set(taken))
    assert set(last) <= set(taken)


def numbers(file: str) -> list[int]:
    path = Path(file)
    return [int(line) for line in path.read_text().split()] if path.exists() else []
