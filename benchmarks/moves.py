"""Moves components a thousand times while they talk, and counts what got lost.

Then it moves a state of 50 MB, that changes slowly, over a link of 100 Mbit/s.

It imports internal modules: it reads components' measures between moves, and kills
containers during moves.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from threading import Timer

from poise.clock import SystemClock
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import plan_move
from poise.model import load
from poise.session.launch.computers import computers_of

ROBOTS = Path(__file__).parent / "robots"
COMPONENTS = ("producer", "relay", "consumer")
_SIGNS = ("answered", "received")


@contextlib.contextmanager
def running(name: str, placement: dict[str, str]) -> Iterator[tuple[LiveRobot, Path]]:
    """Start a robot of `robots/` and yield its run and its folder."""
    robot = load(ROBOTS / name)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="poise-")))
        journal = Journal(folder / "journal.jsonl")
        stack.callback(journal.close)
        computers = stack.enter_context(
            computers_of(robot, folder / "computers", lambda _: None)
        )
        keys = computers.addresses.credentials()
        agents = stack.enter_context(
            Agents(robot.name, computers.endpoints, SystemClock(), keys=keys)
        )
        agents.wait_alive(computers.endpoints, 20)
        live = LiveRobot(robot, placement, agents, journal, str(folder))
        live.start()
        yield live, folder
        stop(live)


def totals(live: LiveRobot, component: str) -> dict[str, float]:
    """Return the largest value of each of a component's measures."""
    found: dict[str, float] = {}
    for status in components_of(live.agents.statuses()):
        if status.name == component:
            for name, summary in status.measures.items():
                found[name] = max(found.get(name, 0.0), summary.maximum)
    return found


def storm(
    live: LiveRobot,
    moves: int,
    limit: float,
    chance: random.Random,
    killing: int = 0,
) -> list[MigrationReport]:
    """Move components at random, `moves` times or for `limit` [s].

    Parameters
    ----------
    killing
        Kill a container at a random moment of every so many moves; 0: of none.
    """
    reports: list[MigrationReport] = []
    until = time.monotonic() + limit
    while len(reports) < moves and time.monotonic() < until:
        component = chance.choice(COMPONENTS)
        here = live.placement()[component]
        if killing and len(reports) % killing == killing - 1:
            kill_soon(live, chance)
        reports.append(plan_move(live, component, "b" if here == "a" else "a").run())
        if sys.stderr.isatty():
            sys.stderr.write(f"\r{len(reports)} moves")
    return reports


def kill_soon(live: LiveRobot, chance: random.Random) -> None:
    """Kill one of the moving components' containers within a move's usual time."""
    pids = [
        container.pid
        for status in live.agents.statuses().values()
        for container in status.containers
        if container.name == "storm"
    ]
    if pids:
        Timer(chance.uniform(0, 0.05), kill, [chance.choice(pids)]).start()


def kill(pid: int) -> None:
    """Kill a process that may have ended."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def is_at_work(live: LiveRobot) -> bool:
    """Return whether numbers go through and calls are answered, within 10 s."""
    for _ in range(20):
        before = totals(live, "producer"), totals(live, "consumer")
        live.agents.wait_news(lambda: False, 0.5)
        after = totals(live, "producer"), totals(live, "consumer")
        if all(
            new.get(name, 0) > old.get(name, 0)
            for old, new, name in zip(
                before, after, ("answered", "received"), strict=True
            )
        ):
            return True
    return False


def count(live: LiveRobot, folder: Path) -> dict[str, int]:
    """Halt the producer, wait until all has arrived, and return the counts."""
    (folder / "halt").touch()
    until = time.monotonic() + 10
    while time.monotonic() < until:
        live.watch(0.7)
        producer, consumer = totals(live, "producer"), totals(live, "consumer")
        # one that has just moved tells its numbers a little later
        if producer.get("sent", 0) == consumer.get("received", -1):
            break
    return {
        "sent": int(producer["sent"]),
        "received": int(consumer["received"]),
        "lost": int(max(consumer["lost"], producer["sent"] - consumer["received"])),
        "doubled": int(consumer["doubled"]),
        "reordered": int(consumer["reordered"]),
        "asked": int(producer["asked"]),
        "answered": int(producer["answered"]),
        "refused": int(producer["refused"]),
    }


def big_state(moves: int) -> dict[str, float]:
    """Move 50 MB there and back while they change and are read; return what it took."""
    with running("archive.yaml", {"archive": "a", "reader": "a"}) as (run, _):
        run.watch(1.0)
        targets = ["b", "a"] * moves
        reports = [
            plan_move(run, "archive", target).run() for target in targets[:moves]
        ]
        run.watch(1.0)
        reader = totals(run, "reader")
    return {
        "big_state_moves": len(reports),
        "big_state_committed": sum(report.committed for report in reports),
        "big_state_downtime_s": max(report.downtime for report in reports),
        "big_state_prepared_s": max(report.prepared for report in reports),
        "big_state_longest_call_s": reader["waited"],
        "big_state_calls_refused": reader["refused"],
        "big_state_answers_wrong": reader["wrong"],
    }


def main() -> None:
    """Run the storm, and move a large state."""
    parser = argparse.ArgumentParser("python -m benchmarks.moves", description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="fewer moves")
    options = parser.parse_args()
    moves, limit = (150, 15.0) if options.quick else (1000, 600.0)
    chance = random.Random(1)
    everywhere = dict.fromkeys((*COMPONENTS, "conductor"), "a")
    with running("storm.yaml", everywhere) as (run, folder):
        reports = storm(run, moves, limit, chance)
        counts = count(run, folder)
    with running("storm.yaml", everywhere) as (run, _):
        struck = storm(run, moves // 2, limit, chance, killing=10)
        works = is_at_work(run)
    big = big_state(2 if options.quick else 10)
    failed = [report for report in reports if not report.committed]
    downtimes = sorted(report.downtime for report in reports)
    result: dict[str, object] = {
        "moves": len(reports),
        "committed": len(reports) - len(failed),
        **counts,
        "hung": counts["asked"] - counts["answered"] - counts["refused"],
        "moves_with_kills": len(struck),
        "committed_with_kills": sum(report.committed for report in struck),
        "longest_downtime_with_kills_s": max(report.downtime for report in struck),
        "works_after_kills": works,
        "downtime_median_s": median(downtimes),
        "downtime_p99_s": downtimes[int(0.99 * len(downtimes))],
        "downtime_max_s": downtimes[-1],
        "phases_median_s": {
            phase: median(report.phases.get(phase, 0.0) for report in reports)
            for phase in ("prepare", "quiesce", "transfer", "commit", "resume")
        },
        **big,
    }
    for report in failed[:5]:
        sys.stderr.write(f"{report.what}: {report.reason}\n")
    if options.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    else:
        for name, value in result.items():
            sys.stdout.write(f"{name:26} {value}\n")


if __name__ == "__main__":
    main()
