"""How near the predicted age of data comes to what is measured on emulated computers.

    python -m benchmarks.data_age [--seconds 8] [--starts 4] [--only 0 3] [--json]

T-Rot, and ten small robots that are made up: chains of timers, messages and calls of
three to five components, on two or three computers that are 40 to 80 % busy, placed at
random. Each is profiled and calibrated, its chains are predicted, and it runs several
times. T-Rot's computers are as quick as those that its profile was measured on. A line
is printed for each chain, and how many come within 25 % (median) and 50 % (99th
percentile): four of five are asked. A run in which this machine did not give the
computers the CPU that they were promised does not count, and that is said. `--json`
prints the same, the lines to stderr. Run it on a machine with nothing else to do. Links
have the latency that they have here: some kernels cannot delay packets.

It imports internal modules: what it runs is as quick as when it was profiled.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import msgspec
from msgspec import Struct
from msgspec.structs import replace

import poise
from poise.model.robot import Robot
from poise.session.profiling.stored_profiles import (
    as_when_profiled,
    read_profile,
    steady,
)
from poise.simulation.predicted_times import predict_times
from poise.simulation.workload import workload_of

ROOT = Path(__file__).parents[1]
TROT = ROOT / "examples/trot"
MADE_UP = 10
NEAR_MEDIAN, NEAR_P99 = 0.25, 0.5
ENOUGH = 0.8
"""This share of chains is to be near."""
_MODULE = '''"""Made up."""
import random
import time

from poise import Component, Message, Provided, Published, Required, every, subscribed


class Datum(Message, frozen=True):
    """A number."""

    number: int


class Ask:
    """What a server is asked."""

    def latest(self) -> Datum:
        """Return what came last."""
        raise NotImplementedError


def burn(seconds: float) -> None:
    """Use about so much CPU time."""
    end = time.thread_time() + seconds * random.lognormvariate(0.0, 0.3)
    while time.thread_time() < end:
        sum(range(100))

'''
_HEAD = '''

class C{i}(Component):
    """Stage {i}."""

    held = Datum(0)
'''
_OUT = "    out: Published[Datum]\n"
_SERVES = "    ask: Provided[Ask]\n"
_ASKS = "    source: Required[Ask]\n"
_TAKES_ON = """
    @subscribed(keep=4)
    def into(self, datum: Datum) -> None:
        burn({job})
        {then}
"""
_TICKS = """
    @every({period})
    def tick(self) -> None:
        {first}
        burn({job})
        {then}
"""
_ANSWERS = """
    def latest(self) -> Datum:
        burn({job})
        return self.held
"""


class Age(Struct, frozen=True):
    """A chain, predicted and measured [s]."""

    robot: str
    chain: str
    median: float
    measured_median: float
    p99: float
    measured_p99: float
    uses: int

    @property
    def is_near(self) -> bool:
        """Whether both figures come near to what was measured."""
        median = abs(self.median - self.measured_median)
        p99 = abs(self.p99 - self.measured_p99)
        return (
            median <= NEAR_MEDIAN * self.measured_median
            and p99 <= NEAR_P99 * self.measured_p99
        )


def main() -> None:
    """Compare the robots that the command line names."""
    names = ["t-rot", *map(str, range(MADE_UP))]
    parser = argparse.ArgumentParser(
        "python -m benchmarks.data_age", description=__doc__
    )
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--only", nargs="*", default=names, choices=names)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found: list[Age] = []
    for name in asked.only:
        with tempfile.TemporaryDirectory() as folder:
            if name == "t-rot":
                robot = trot(Path(folder))
            else:
                robot = poise.load(made_up(int(name), Path(folder)))
            ages = compare(name, robot, asked.seconds, asked.starts)
        found += ages
        print_table(ages, sys.stderr if asked.json else sys.stdout)
    near = sum(each.is_near for each in found)
    if asked.json:
        rows = [{**msgspec.to_builtins(e), "near": e.is_near} for e in found]
        told = {"near": near, "chains": len(found), "asked": ENOUGH, "ages": rows}
        print(msgspec.json.format(msgspec.json.encode(told)).decode())
    else:
        print(f"{near} of {len(found)} chains are near; {ENOUGH:.0%} are asked")


def compare(name: str, robot: Robot, seconds: float, starts: int) -> list[Age]:
    """Return the chains of one robot."""
    say(f"{name}: profiled and calibrated")
    poise.profile(robot, seconds=seconds)
    poise.calibrate(robot, seconds=seconds, force=True)
    task = robot.tasks[0].name
    method = "auto" if name == "t-rot" else "random:1"
    placed = poise.place(robot, task, method=method, at_once=True)
    runs = []
    for start in range(starts):
        say(f"{name}: emulated for {seconds:g} s, start {start + 1}")
        with steady(robot):
            run = poise.run(
                as_when_profiled(robot),
                task,
                seconds=seconds,
                placement=placed,
                adapt=False,
            )
        if run.invalid:
            say(f"{name}: does not count: {run.invalid}")
        else:
            runs.append(run)
    if not runs:
        return []
    emulated = as_emulated(robot, runs[0].without)
    work = workload_of(emulated, read_profile(emulated))
    ages = []
    for chain in predict_times(emulated, placed.where, work).chains:
        measured = [
            each.age
            for run in runs
            for each in run.chains
            if each.name == chain.name and each.age.count
        ]
        uses = sum(age.count for age in measured)
        if uses:
            median = sum(age.count * age.median for age in measured) / uses
            p99 = sum(age.count * age.p99 for age in measured) / uses
            ages.append(
                Age(name, chain.name, chain.median, median, chain.p99, p99, uses)
            )
    return ages


def as_emulated(robot: Robot, without: Sequence[str]) -> Robot:
    """Return the robot as this machine emulates it: some kernels delay no packets.

    `without`: what the emulation did without.
    """
    if not any("link latency" in each for each in without):
        return robot
    return replace(robot, links=tuple(replace(k, latency=0.0) for k in robot.links))


def trot(folder: Path) -> Robot:
    """Return a copy of T-Rot, to be measured on this machine."""
    copy = shutil.copytree(TROT, folder, dirs_exist_ok=True)
    return as_when_profiled(poise.load(copy / "robot.yaml"))


def print_table(ages: list[Age], where: TextIO) -> None:
    """Print the chains of one robot."""
    for each in ages:
        verdict = "" if each.is_near else "  differs"
        print(
            f"{each.robot:6} {each.chain:10} median {each.median * 1e3:7.1f} ms, "
            f"measured {each.measured_median * 1e3:7.1f}; p99 {each.p99 * 1e3:7.1f}, "
            f"measured {each.measured_p99 * 1e3:7.1f} ({each.uses} uses){verdict}",
            file=where,
            flush=True,
        )


def made_up(seed: int, folder: Path) -> Path:
    """Write a robot and its code, and return the robot file."""
    chance = random.Random(f"data age {seed}")
    code, connectors, chains = [_MODULE], [], []
    num = 0
    for k in range(chance.choice((2, 2, 3))):
        stages = [num + i for i in range(chance.randint(3, 5))]
        num = stages[-1] + 1
        kinds = [
            "source",
            *chance.choices(["filter", "sampler", "server"], k=len(stages) - 1),
        ]
        if kinds[-1] == "server":  # somebody has to ask it
            kinds[-1] = "filter"
        period = chance.choice((0.02, 0.04, 0.05, 0.1))
        asks = False
        for i, kind in zip(stages, kinds, strict=True):
            is_last = i == stages[-1]
            slower = period * chance.choice((1.0, 1.3, 2.0))
            code.append(stage(i, kind, chance, slower, asks=asks, is_last=is_last))
            asks = kind == "server"
        for (one, kind), (other, _) in pairwise(zip(stages, kinds, strict=True)):
            ends = (
                f"c{other}.source, c{one}.ask"
                if kind == "server"
                else f"c{one}.out, c{other}.into"
            )
            connectors.append(f"      - {{between: [{ends}]}}")
        names = ", ".join(f"c{i}" for i in stages)
        chains.append(f"  chain{k}: {{through: [{names}], deadline: 1 s}}")
    # computers that share a CPU of the host wait for each other, which no real ones do
    num_computers = min(chance.choice((2, 3)), max(2, os.cpu_count() or 2))
    cpu = chance.uniform(0.4, 0.6)
    components = "\n".join(
        f'      c{i}: {{implementation: "made_up_{seed}:C{i}", '
        f"isolated: {str(chance.random() < 0.5).lower()}}}"
        for i in range(num)
    )
    computers = "\n".join(
        f"  m{k}: {{cpu: {cpu:.2f}, memory: 1 GiB}}" for k in range(num_computers)
    )
    links = "\n".join(
        f"  - {{between: [m{a}, m{b}], bandwidth: 100 Mbit/s, latency: "
        f"{chance.choice((0.2, 1, 5))} ms}}"
        for a in range(num_computers)
        for b in range(a)
    )
    lines = (
        f"robot: made-up-{seed}",
        "computers:",
        computers,
        "links:",
        links,
        "architectures:",
        "  all:",
        "    function: all",
        "    components:",
        components,
        "    connectors:",
        *connectors,
        "chains:",
        *chains,
        "tasks: {work: {actions: [{name: work, functions: [all]}]}}",
        "profile: profile.yaml",
        "",
    )
    (folder / f"made_up_{seed}.py").write_text("".join(code))
    path = folder / "robot.yaml"
    path.write_text("\n".join(lines))
    return path


def stage(
    i: int,
    kind: str,
    chance: random.Random,
    period: float,
    *,
    asks: bool,
    is_last: bool,
) -> str:
    """Return the code of a component."""
    job = chance.uniform(0.01, 0.06) * period
    hand_on = "pass" if is_last else "self.out.publish(self.held)"
    ticks = kind in {"source", "sampler"} or asks
    text = _HEAD.format(i=i)
    text += _OUT if not is_last and kind != "server" else ""
    text += _SERVES if kind == "server" else ""
    text += _ASKS if asks else ""
    if ticks:
        first = "self.held = self.source.latest()" if asks else "pass"
        then = "pass" if kind == "server" else hand_on
        text += _TICKS.format(period=period, job=job, first=first, then=then)
    if kind != "source" and not asks:
        keep = "self.held = datum"
        then = keep if ticks or kind == "server" else f"{keep}\n        {hand_on}"
        text += _TAKES_ON.format(job=job, then=then)
    if kind == "server":
        text += _ANSWERS.format(job=job)
    return text


def say(text: str) -> None:
    """Tell what is measured now."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
