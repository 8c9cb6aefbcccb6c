"""What Poise costs a computer that has nothing to do: ``python -m benchmarks.idle``.

How long an agent takes until it is there, and a container until its components are
active; what both use when nothing happens, samples and reports included; what the
manager of `examples/hello` uses, which watches and adapts two components that exchange
ten messages a second; and what all hold of the memory (proportional set size: shared
pages are divided by their users).

It imports internal modules: it measures agents and containers one by one.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from threading import Thread

from benchmarks.synthetic import robots
from poise.clock import SystemClock
from poise.kernel_counters import proportional_memory
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.model.robot import Robot
from poise.session.launch.computers import computers_of
from poise.wire.records.status_records import AgentStatus

HELLO = Path(__file__).parents[1] / "examples" / "hello" / "robot.yaml"
CONTAINERS = 4
SETTLE = 1.0
LIMIT = 30.0
MIB = 2.0**20


def parent(pid: int) -> int:
    """Return the process that started another."""
    stat = Path(f"/proc/{pid}/stat").read_text()
    return int(stat.rpartition(")")[2].split()[1])


def own_cpu(status: AgentStatus) -> float:
    """Return the CPU time of an agent and of what it keeps for containers [s]."""
    return status.cpu - sum(container.cpu for container in status.containers)


def measure(robot: Robot, seconds: float) -> Mapping[str, float]:
    """Start a robot, leave it alone for `seconds`, and tell what that cost."""
    placement = {c.name: robot.computers[0].name for c in robot.components()}
    journal = Journal(":memory:")
    with ExitStack() as stack:
        stack.callback(journal.close)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        began = time.monotonic()
        computers = stack.enter_context(
            computers_of(robot, folder / "computers", lambda _: None)
        )
        there, clock = computers.addresses, SystemClock()
        agents = stack.enter_context(
            Agents(
                robot.name,
                there.endpoints,
                clock,
                lambda _: None,
                keys=there.credentials(),
            )
        )
        agents.wait_alive(computers.endpoints, LIMIT, computers.raise_if_ended)
        agent_there = time.monotonic()
        live = LiveRobot(robot, placement, agents, journal, str(folder))
        stack.callback(stop, live)
        live.start()
        active = time.monotonic()
        live.watch(SETTLE)
        (before,) = agents.statuses().values()
        time.sleep(seconds)
        (after,) = agents.statuses().values()
        lasted = after.uptime - before.uptime
        pids = [container.pid for container in after.containers]
        zygote = parent(pids[0])
        return {
            "agent_start_s": agent_there - began,
            "start_s": active - agent_there,
            "agent_cores": (own_cpu(after) - own_cpu(before)) / lasted,
            "all_cores": (after.cpu - before.cpu) / lasted,
            "agent_mib": proportional_memory(parent(zygote)) / MIB,
            "zygote_mib": proportional_memory(zygote) / MIB,
            "container_mib": statistics.mean(map(proportional_memory, pids)) / MIB,
        }


def measure_manager(seconds: float) -> Mapping[str, float]:
    """Keep a robot up by `poise up`, and return what the manager's process uses."""
    argv = [sys.executable, "-m", "poise", "up", str(HELLO), "--task", "greet"]
    with subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as manager:
        assert manager.stdout is not None
        try:
            lines = []
            for line in manager.stdout:
                lines.append(line)
                if "is up" in line:
                    break
            else:
                sys.exit(f"{shlex.join(argv)} did not come up:\n{''.join(lines)}")
            Thread(target=deque, args=(manager.stdout, 0), daemon=True).start()
            time.sleep(SETTLE)
            before, began = cpu_of(manager.pid), time.monotonic()
            time.sleep(seconds)
            used = cpu_of(manager.pid) - before
            lasted = time.monotonic() - began
            memory = proportional_memory(manager.pid)
        finally:
            manager.terminate()
            manager.wait(timeout=LIMIT)
    return {"cores": used / lasted, "mib": memory / MIB}


def cpu_of(pid: int) -> float:
    """Return the CPU time of a process without its children [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure all, and print it."""
    parser = argparse.ArgumentParser("python -m benchmarks.idle", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--quick", action="store_true", help="under a minute")
    options = parser.parse_args()
    seconds = 8.0 if options.quick else 30.0
    # the components' module is imported from the benchmarks' folder
    sys.path.insert(0, robots.FOLDER)
    one = measure(robots.silent(1), seconds)
    many = measure(robots.silent(CONTAINERS), seconds)
    manager = measure_manager(seconds)
    found = {
        "agent until it is there [s]": one["agent_start_s"],
        "a container with six components, until they are active [s]": one["start_s"],
        f"{CONTAINERS} containers, together [s]": many["start_s"],
        "agent of a container that does nothing [cores]": one["agent_cores"],
        f"agent of {CONTAINERS} containers that do nothing [cores]": many[
            "agent_cores"
        ],
        "a container that does nothing [cores]": (
            many["all_cores"] - many["agent_cores"]
        )
        / CONTAINERS,
        "manager [cores]": manager["cores"],
        "manager [MiB]": manager["mib"],
        "agent [MiB]": many["agent_mib"],
        "zygote [MiB]": many["zygote_mib"],
        f"each of {CONTAINERS} containers [MiB]": many["container_mib"],
    }
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        print(f"{name:60} {value:.4f}")


if __name__ == "__main__":
    main()
