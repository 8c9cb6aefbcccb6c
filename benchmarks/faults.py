"""How quickly what was killed is back, and what checkpoints cost.

``python -m benchmarks.faults``: containers are killed by SIGKILL, then the agent, on
one emulated computer. Times are by the clock that all processes of this machine share.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from statistics import median

import poise

CODE = """
import os, time
from poise import Component, Message, every

class Stamped(Message):
    at: float
    data: bytes

class Worker(Component):
    at = restored = pause = 0.0

    def configure(self):
        self.data = os.urandom(self.parameters.get("size", 0))

    def activate(self):
        self.tell("active", time.monotonic(), self.restored)

    @every(0.005)
    def tick(self):
        now = time.monotonic()
        if self.at and now - self.at > self.pause:
            self.pause = now - self.at
            self.tell("pause", self.pause, 0.0)
        self.at = now

    def snapshot(self):
        return Stamped(time.monotonic(), self.data)

    def restore(self, state: Stamped):
        self.restored = state.at

    def path(self, what):
        return os.path.join(self.parameters["folder"], f"{self.name}.{what}")

    def tell(self, what, *values):
        path = self.path(what)
        with open(path + ".new", "w") as file:
            file.write(f"{os.getpid()} {values[0]} {values[1]}")
        os.replace(path + ".new", path)
"""
ROBOT = """
robot: {name}
computers: {{only: {{cpu: 2, memory: 3 GiB}}}}
policies: {{crash-loop: off}}
architectures:
  work:
    function: work
    components:
{components}
tasks: {{work: {{actions: [{{name: work, functions: [work]}}]}}}}
"""
COMPONENT = """
      {name}: {{implementation: "faults_bench:Worker", isolated: true, cpu: 10%,
        memory: 100 MiB, {checkpoint} parameters: {{folder: "{folder}", size: {size}}}}}
"""
SIZES = {"1 KB": 1_000, "1 MB": 1_000_000, "10 MB": 10_000_000}
CONTAINERS = 4
CALM = 11.0
"""After so long without an end a container is restarted at once [s]."""
LIMIT = 60.0


class Watched:
    """A robot that is up, and what its components say."""

    def __init__(self, folder: Path, robot: poise.Running) -> None:
        self.robot = robot
        self._folder = folder

    def said(self, component: str, what: str) -> tuple[int, float, float]:
        """Return what a component said last: its process, and two values."""
        try:
            words = (self._folder / f"{component}.{what}").read_text().split()
        except FileNotFoundError:
            return 0, 0.0, 0.0
        return int(words[0]), float(words[1]), float(words[2])

    def kill(self, component: str) -> tuple[float, float]:
        """Kill a container; return when it is back, and the age of its state [s]."""
        pid, _, _ = self.said(component, "active")
        began = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        wait(lambda: self.said(component, "active")[0] != pid)
        _, active, restored = self.said(component, "active")
        return active - began, began - restored

    def agent(self) -> int:
        """Return the process of the agent that reported last."""
        return self.robot.status().computers["only"].pid


def wait(holds: Callable[[], object]) -> None:
    """Wait until something holds; raise TimeoutError when it does not."""
    deadline = time.monotonic() + LIMIT
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"it did not hold within {LIMIT:g} s")
        time.sleep(0.002)


@contextlib.contextmanager
def up(components: Mapping[str, tuple[int, str]]) -> Iterator[Watched]:
    """Start a robot of components with a state of some size and a checkpoint."""
    name = f"faults-{os.getpid()}"
    with tempfile.TemporaryDirectory() as path:
        folder = Path(path)
        (folder / "faults_bench.py").write_text(CODE)
        lines = [
            COMPONENT.format(
                name=each, size=size, checkpoint=checkpoint, folder=folder
            ).strip("\n")
            for each, (size, checkpoint) in components.items()
        ]
        text = ROBOT.format(name=name, components="\n".join(lines))
        (folder / "robot.yaml").write_text(text)
        argv = (sys.executable, "-m", "poise", "up", str(folder / "robot.yaml"))
        with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            try:
                if not any("is up" in line for line in process.stdout):
                    raise RuntimeError("the robot did not come up")
                yield Watched(folder, poise.connect(name))
            finally:
                process.terminate()
                process.communicate(timeout=LIMIT)


def kills(rounds: int) -> Iterator[tuple[str, float]]:
    """Kill containers and the agent; yield what was measured [s]."""
    stateless = {f"worker{number}": (0, "") for number in range(CONTAINERS)}
    kept = {"kept": (1_000, "checkpoint: 1 s,")}
    with up(stateless | kept) as watched:
        back, ages = [], []
        for number in range(rounds):
            time.sleep(CALM + number * 0.3 % 1.0)  # at any time after a checkpoint
            back += [watched.kill(name)[0] for name in stateless]
            ages.append(watched.kill("kept")[1])
        yield "container killed, active again: median [s]", median(back)
        yield f"container killed, active again: longest of {len(back)} [s]", max(back)
        yield f"age of a restored state: oldest of {len(ages)} [s]", max(ages)
        # by what they say themselves: a status may be half a second old
        pids = {watched.said(name, "active")[0] for name in stateless | kept}
        before = watched.agent()
        began = time.monotonic()
        os.kill(before, signal.SIGKILL)

        def is_managed() -> bool:
            status = watched.robot.status()
            agent = status.computers.get("only")
            if agent is None or agent.pid == before or status.out_of_reach:
                return False
            return pids <= {each.pid for each in agent.containers}

        wait(is_managed)
        yield "agent killed, its containers managed again [s]", time.monotonic() - began


def cpu_time(pid: int) -> float:
    """Return the CPU time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cost(size: int, checkpoint: str, seconds: float) -> tuple[float, float, float]:
    """Return what a component, and agent and manager, take [cores], and its pause."""
    with up({"kept": (size, checkpoint)}) as watched:
        time.sleep(2.0)
        container = watched.said("kept", "active")[0]
        others = watched.agent(), watched.robot.status().manager.pid
        before = cpu_time(container), sum(map(cpu_time, others))
        time.sleep(seconds)
        after = cpu_time(container), sum(map(cpu_time, others))
        used = [(b - a) / seconds for a, b in zip(before, after, strict=True)]
        return used[0], used[1], watched.said("kept", "pause")[1]


def costs(seconds: float) -> Iterator[tuple[str, float]]:
    """Yield what checkpoints at 1 Hz cost, beside the same without them."""
    idle, others, pause = cost(0, "", seconds)
    yield "longest pause without checkpoints [s]", pause
    for name, size in SIZES.items():
        mine, rest, pause = cost(size, "checkpoint: 1 s,", seconds)
        yield f"checkpoints of {name}: container [cores]", mine - idle
        yield f"checkpoints of {name}: agent and manager [cores]", rest - others
        yield f"checkpoints of {name}: longest pause [s]", pause


def main() -> None:
    """Measure all, and print it."""
    parser = argparse.ArgumentParser("python -m benchmarks.faults", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--quick", action="store_true", help="about a minute")
    options = parser.parse_args()
    found = dict(kills(1 if options.quick else 5))
    found |= costs(3.0 if options.quick else 15.0)
    found["load average"] = os.getloadavg()[0]
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        print(f"{name:60} {value:8.4f}")


if __name__ == "__main__":
    main()
