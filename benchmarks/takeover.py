"""Kills the manager at random steps of moves, and lets the next one take over.

Each manager is a process of its own. It kills itself, by SIGKILL, at a step that the
seed chooses: before, between or after what it tells the agents. The next one must find
each component active exactly once, and messages must be neither doubled nor reordered.

It imports internal modules: it kills inside moves.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median

from msgspec import Struct

from benchmarks.moves import COMPONENTS, ROBOTS, count
from poise.clock import SystemClock
from poise.errors import PoiseError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.requests import PendingAnswer
from poise.manage.agent_connections.statuses import components_of
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.takeover import start_or_take_over
from poise.manage.journal import Journal
from poise.manage.migration.move import plan_move
from poise.model import load
from poise.session.launch.computers import computers_of
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, StepsOutcome
from poise.wire.robots_here import AgentAddresses

PLACEMENT = dict.fromkeys((*COMPONENTS, "conductor"), "a")
_MOST_STEPS = 40
"""A manager ends within this many of its steps: some two moves."""
_LATER = 0.01
"""A manager may also end within this time after a step [s]."""
_CONSISTENT = 20.0
"""A robot is consistent within this time after a take-over [s]."""
_LIFE = 60.0
"""A manager that does not end by itself within this time hangs [s]."""


class TakenOver(Struct, frozen=True, kw_only=True):
    """How a manager took over.

    Parameters
    ----------
    back, connected
        When it managed, since it was started and since its agents were there [s].
    restarted
        Components that did not go on as they ran.
    twice, missing
        Components that were active twice, or not, at the end of `_CONSISTENT`.
    half_done
        What it found of a move.
    """

    back: float
    connected: float
    restarted: int
    twice: tuple[str, ...]
    missing: tuple[str, ...]
    half_done: str


class DoomedAgents(Agents):
    """Agents whose manager is killed at a step."""

    doom: random.Random | None = None
    left = 0

    def begin(self, chance: random.Random, most: int) -> None:
        """Die within this many steps."""
        self.left = chance.randint(1, most)
        self.doom = chance

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        """Tell an agent, or die before or after that."""
        if self._is_last() and self.doom is not None and self.doom.random() < 0.5:
            _die()
        reply = super().begin_deploy(computer, deployment)
        self._step()
        return reply

    def send_steps(
        self,
        batches: Iterable[tuple[str, MigrationSteps]],
        check: Callable[[], object] = lambda: None,
    ) -> Iterator[StepsOutcome]:
        """Let containers take steps; die before, amid or after that."""
        self._step()
        told = list(batches)
        if self._is_last() and self.doom is not None:
            told = self.doom.sample(told, self.doom.randint(0, len(told)))
            threading.Timer(self.doom.uniform(0, _LATER), _die).start()
        for outcome in super().send_steps(told, check):
            self._step()
            yield outcome
        self._step()

    def _is_last(self) -> bool:
        return self.doom is not None and self.left == 1

    def _step(self) -> None:
        if self.doom is None:
            return
        self.left -= 1
        if self.left <= 0:
            _die()


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@contextlib.contextmanager
def manager(
    there: AgentAddresses, folder: Path, *, doomed_from: int | None = None
) -> Iterator[tuple[LiveRobot, DoomedAgents, float]]:
    """Take over the robot; yield its run, its agents, and when these were there."""
    robot = load(ROBOTS / "storm.yaml")
    journal = Journal(folder / "journal.jsonl")
    keys = there.credentials()
    with (
        contextlib.closing(journal),
        DoomedAgents(robot.name, there.endpoints, SystemClock(), keys=keys) as agents,
    ):
        agents.wait_alive(there.endpoints, 20)
        connected = time.monotonic()
        if doomed_from is not None:
            agents.begin(random.Random(doomed_from), 4)
        live = LiveRobot(robot, PLACEMENT, agents, journal, str(folder))
        start_or_take_over(live, by_force=False)
        yield live, agents, connected


def active(live: LiveRobot) -> Counter[str]:
    """Return how often each component is active."""
    found = components_of(live.current())
    return Counter(each.name for each in found if each.state == "active")


def live(
    computers: AgentAddresses, folder: Path, seed: int, began: float, out: Connection
) -> None:
    """Be a manager until it kills itself."""
    chance = random.Random(seed)
    # some die while they take over
    doomed_from = seed if chance.random() < 0.15 else None
    with manager(computers, folder, doomed_from=doomed_from) as (run, agents, there):
        now = time.monotonic()
        once = Counter(run.placed.keys())
        run.agents.wait_news(lambda: active(run) == once, _CONSISTENT)
        seen = active(run)
        said = run.journal.entries()
        out.send(
            TakenOver(
                back=now - began,
                connected=now - there,
                restarted=sum("restarts" in e.what for e in said),
                twice=tuple(n for n, times in seen.items() if times > 1),
                missing=tuple(sorted(once.keys() - seen.keys())),
                half_done=next(
                    (e.what for e in said if "was interrupted" in e.what), ""
                ),
            )
        )
        if agents.doom is None:
            agents.begin(chance, _MOST_STEPS)
        while True:
            component = chance.choice(COMPONENTS)
            here = run.placement()[component]
            plan_move(run, component, "b" if here == "a" else "a").run()


def storm(
    computers: AgentAddresses, folder: Path, kills: int, seed: int
) -> Iterator[TakenOver | None]:
    """Let managers live and die; yield how each took over, None when it did not."""
    context = multiprocessing.get_context("forkserver")
    for number in range(kills):
        reading, writing = context.Pipe(duplex=False)
        began = time.monotonic()
        process = context.Process(
            target=live,
            args=(computers, folder, seed * 1_000_003 + number, began, writing),
        )
        process.start()
        writing.close()
        process.join(_LIFE)
        if process.exitcode != -signal.SIGKILL:
            process.kill()
            raise PoiseError(f"manager {number} ended with {process.exitcode}")
        with contextlib.suppress(EOFError):
            yield reading.recv()
            continue
        yield None


def main() -> None:
    """Kill managers, and say how the next ones took over."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.takeover", description=__doc__
    )
    parser.add_argument("--moves", type=int, default=500, help="managers to kill")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    multiprocessing.set_forkserver_preload(["benchmarks.moves"])
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="poise-")))
        robot = load(ROBOTS / "storm.yaml")
        computers = stack.enter_context(
            computers_of(robot, folder / "computers", lambda _: None)
        )
        found: list[TakenOver | None] = []
        for each in storm(computers.addresses, folder, options.moves, options.seed):
            found.append(each)
            if each and (each.twice or each.missing or each.restarted):
                sys.stderr.write(f"manager {len(found) - 1}: {each}\n")
            if sys.stderr.isatty():
                sys.stderr.write(f"\r{len(found)} managers")
        with manager(computers.addresses, folder) as (run, _, _there):
            counts = count(run, folder)
            stop(run)
    result = summary([each for each in found if each], counts)
    result["killed_while_taking_over"] = found.count(None)
    if options.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    else:
        for name, value in result.items():
            sys.stdout.write(f"{name:26} {value}\n")
    bad = ("active_twice", "missing", "restarted", "doubled", "reordered")
    sys.exit(any(result[name] for name in bad))


def summary(found: list[TakenOver], counts: Mapping[str, int]) -> dict[str, object]:
    """Return the figures of all managers that took over; the first only started."""
    later = found[1:]
    backs = sorted(each.back for each in later)
    connected = sorted(each.connected for each in later)
    return {
        "managers": len(found),
        "half_done": sum(bool(each.half_done) for each in later),
        "finished": sum("is finished" in each.half_done for each in later),
        "rolled_back": sum("is rolled back" in each.half_done for each in later),
        "active_twice": sum(bool(each.twice) for each in found),
        "missing": sum(bool(each.missing) for each in found),
        "restarted": sum(each.restarted for each in found),
        "back_median_s": round(median(backs), 3),
        "back_max_s": round(backs[-1], 3),
        "connected_median_s": round(median(connected), 3),
        "connected_max_s": round(connected[-1], 3),
        **counts,
    }


if __name__ == "__main__":
    main()
