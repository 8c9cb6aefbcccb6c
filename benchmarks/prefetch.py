"""How long switches from one action to the next take, with prefetch and without.

``python -m benchmarks.prefetch [--seconds 60] [--robot FILE --task NAME] [--json]``

A task is done again and again, in turn with prefetch and without it; nothing rests
between actions, so that without prefetch everything starts anew. Deadlines count for
components that run in all actions. Without ``--robot`` it is a robot of two emulated
computers of half a core, whose components import some of Python's own modules and
compute for 0.2 s when they are configured.

It imports internal modules: their records let any robot be tried both ways.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

from msgspec.structs import replace

import poise
from poise.model.steps import Prefetch, Repeat, Task, actions_of

CODE = """
import time
from poise import Component, Published, every

class Steady(Component):
    @every(0.02, deadline=0.02)
    def tick(self):
        compute(0.002)

class Able(Component):
    ended: Published[bool]

    def configure(self):
        import asyncio, decimal, email.message, sqlite3, xml.dom.minidom
        compute(0.2)

    def activate(self):
        self.ticks = 0

    @every(0.1)
    def tick(self):
        self.ticks += 1
        if self.ticks == self.parameters["ticks"]:
            self.ended.publish(True)

def compute(seconds):
    until = time.thread_time() + seconds
    while time.thread_time() < until:
        pass
"""
ROBOT = """
robot: prefetch-bench
computers:
  left: {cpu: 50%, memory: 512 MiB}
  right: {cpu: 50%, memory: 512 MiB}
architectures:
  base: {function: balancing, components: {
    legs: {implementation: "prefetch_bench:Steady", cpu: 12%, memory: 20 MiB,
      only: [left]},
    trunk: {implementation: "prefetch_bench:Steady", cpu: 12%, memory: 20 MiB,
      only: [right]}}}
"""
ABLE = """
  {name}: {{function: {name}, components: {{
    {name}1: {{implementation: "prefetch_bench:Able", cpu: 5%, memory: 40 MiB,
      isolated: true, only: [left], parameters: {{ticks: 25}}}},
    {name}2: {{implementation: "prefetch_bench:Able", cpu: 5%, memory: 40 MiB,
      isolated: true, only: [right], parameters: {{ticks: 1000000}}}}}}}}
"""
NAMES = ("seeing", "driving", "grasping")


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.prefetch")
    parser.add_argument("--seconds", type=float, default=60.0, help="with and without")
    parser.add_argument("--robot", type=Path, help="another robot")
    parser.add_argument("--task", help="its task that is done; its first")
    parser.add_argument("--json", action="store_true", help="write JSON")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = arguments.robot or own_robot(Path(folder))
        robot = again_and_again(poise.load(file), arguments.task)
        report = measured(robot, arguments.seconds)
    if arguments.json:
        json.dump(report, sys.stdout, indent=1)
        return
    for name in ("hit", "miss"):
        times = report[f"switch_{name}_s"]
        print(
            f"{name}: {times['count']} switches, median {times['median']:.3f} s, "
            f"p99 {times['p99']:.3f} s"
        )
    print(
        f"with prefetch {report['less_median']:.0%} less in the median, "
        f"{report['less_p99']:.0%} less at p99; hit rate {report['hit_rate']:.0%}; "
        f"{report['wasted_bytes'] / 1e6:.0f} MB prepared for nothing"
    )
    for name in ("with", "without"):
        print(
            f"deadlines missed {name} prefetch: {report[f'missed_{name}']} of "
            f"{report[f'releases_{name}']}"
        )


def own_robot(folder: Path) -> Path:
    """Write the robot of this benchmark."""
    (folder / "prefetch_bench.py").write_text(CODE)
    actions = "\n".join(
        f"      - {{name: do-{name}, functions: [balancing, {name}], "
        f"ends: {name}1.ended, limit: 60 s}}"
        for name in NAMES
    )
    text = ROBOT + "".join(ABLE.format(name=name).strip("\n") + "\n" for name in NAMES)
    text += f"tasks:\n  work:\n    actions:\n{actions}\n"
    (folder / "robot.yaml").write_text(text)
    return folder / "robot.yaml"


def again_and_again(robot: poise.Robot, name: str | None) -> poise.Robot:
    """Return the robot with a task that is done without end, and no lingering."""
    task = robot.task(name) if name else robot.tasks[0]
    endless = Task(name=task.name, actions=(Repeat(steps=task.actions),))
    return replace(
        robot,
        architectures=tuple(replace(a, linger=0.0) for a in robot.architectures),
        tasks=(endless, *(each for each in robot.tasks if each.name != task.name)),
    )


def measured(robot: poise.Robot, seconds: float) -> dict[str, Any]:
    """Return times of switches, and deadlines missed, with and without prefetch."""
    switches: dict[bool, list[float]] = {True: [], False: []}
    counts: dict[str, list[int]] = {}
    rounds = max(1, round(seconds / 60))
    hits = count = wasted = 0
    for _ in range(rounds):
        for name, bounds in (("with", Prefetch()), ("without", Prefetch(off=True))):
            once = run_for(replace(robot, prefetch=bounds), seconds / rounds)
            for is_hit, spent in once["switches"]:
                switches[is_hit].append(spent)
            if name == "with":
                hits += sum(is_hit for is_hit, _ in once["switches"])
                count += len(once["switches"])
                wasted += once["wasted"]
            before = counts.setdefault(name, [0, 0])
            counts[name] = [before[0] + once["missed"], before[1] + once["releases"]]
    hit, miss = summary(switches[True]), summary(switches[False])
    return {
        "switch_hit_s": hit,
        "switch_miss_s": miss,
        "less_median": 1 - hit["median"] / miss["median"],
        "less_p99": 1 - hit["p99"] / miss["p99"],
        "hit_rate": hits / count if count else None,
        "wasted_bytes": wasted,
        "missed_with": counts["with"][0],
        "releases_with": counts["with"][1],
        "missed_without": counts["without"][0],
        "releases_without": counts["without"][1],
    }


def run_for(robot: poise.Robot, seconds: float) -> dict[str, Any]:
    """Keep a robot up, and return what its journal and its timers say."""
    with tempfile.TemporaryDirectory() as folder:
        journal = Path(folder) / "journal.jsonl"
        with poise.up(robot, journal=journal, adapt=False) as running:
            time.sleep(seconds)
            status = running.status()
        entries = [e for e in poise.read_journal(journal) if "is_hit" in e.facts]
    steady = set(always(robot))
    timers = [
        timer
        for computer in status.computers.values()
        for container in computer.containers
        for component in container.components
        for timer in component.timers
        if component.name in steady and timer.deadline is not None
    ]
    return {
        "switches": [(e.facts["is_hit"], e.facts["seconds"]) for e in entries],
        "missed": sum(timer.missed for timer in timers),
        "releases": sum(timer.releases for timer in timers),
        "wasted": status.prefetch.wasted,
    }


def always(robot: poise.Robot) -> Iterator[str]:
    """Yield the components that all actions need."""
    tasks = {task.name: task for task in robot.tasks}
    needs = [set(a.functions) for a in actions_of(tasks, robot.tasks[0].name)]
    for architecture in robot.architectures:
        if all(architecture.function in functions for functions in needs):
            for component in architecture.components:
                yield component.name


def summary(times: list[float]) -> dict[str, float]:
    """Return the number of times [s], their median and their 99th percentile."""
    ordered = sorted(times) or [float("nan")]
    return {
        "count": len(times),
        "median": median(ordered),
        "p99": ordered[min(len(ordered) - 1, round(0.99 * len(ordered)))],
    }


if __name__ == "__main__":
    main()
