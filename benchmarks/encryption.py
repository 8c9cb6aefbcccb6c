"""What TLS costs between computers: ``python -m benchmarks.encryption``.

Calls of 64 B over loopback, beside a query of zenoh; calls that return 1 MB, and moves
of a state of 50 MB, over a link of 1 Gbit/s between emulated computers; and the CPU use
of an agent with nothing to do. Each without TLS and with it, in turns, for the speed of
a machine drifts; of the rounds, the median of differences or quotients counts.

It imports internal modules: keys for processes that no agent starts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import TypeVar

from benchmarks.calls.cases import CASES
from benchmarks.calls.pair import run
from benchmarks.idle import cpu_of
from benchmarks.moves import running
from poise.clock import SystemClock
from poise.endpoint import Endpoint
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.statuses import components_of
from poise.manage.migration.move import plan_move
from poise.session.keys import init_keys
from poise.session.launch.computers import ENCRYPT
from poise.wire.address import KEYS
from poise.wire.control_session import locator
from poise.wire.credentials import Credentials

LIMITS = {
    "call_64_b_more_us": 10.0,
    "call_64_b_of_zenoh_query": 1.0,
    "call_1_mb_times": 1.25,
    "move_50_mb_times": 1.3,
    "idle_agent_more_cores": 0.001,
}
"""How much TLS may cost."""
T = TypeVar("T")
SIZE = 64
PORT = 17449
BIG = {"camera": "a", "viewer": "b", "archive": "a"}


@contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """Set an environment variable for a while; empty: it is not set."""
    if value:
        os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name, None)


def small_call(title: str, calls: int, keys: str = "") -> float:
    """Return the median of a case of `benchmarks.calls` at 64 B [us]."""
    (case,) = (case for case in CASES if case.title == title)
    small = type(case)(case.title, case.module, (SIZE,))
    with variable(KEYS, keys):
        return run(small, {SIZE: calls}).times[0].median_us


def large(seconds: float, *, is_encrypted: bool) -> tuple[float, float]:
    """Return how long a call with 1 MB takes, and a move of 50 MB [s]."""
    with (
        variable(ENCRYPT, "1" if is_encrypted else ""),
        running("encrypted.yaml", BIG) as (robot, _),
    ):
        robot.watch(seconds)
        trips = [
            component.measures["trip"].median
            for component in components_of(robot.agents.statuses())
            if component.name == "viewer"
        ]
        reports = [plan_move(robot, "archive", target).run() for target in ("b", "a")]
        assert all(report.committed for report in reports), reports
    (trip,) = trips
    return trip, median(report.prepared + report.downtime for report in reports)


def idle(seconds: float, folder: Path, keys: str = "") -> float:
    """Return what an agent uses that runs nothing, and has a manager [cores]."""
    words = ["agent", "left", "--robot", "idle", "--address", "127.0.0.1"]
    words += ["--port", str(PORT), "--folder", str(folder)]
    words += ["--keys", keys] if keys else ["--insecure"]
    own = Credentials(Path(keys).parent) if keys else None
    where = {"left": locator(Endpoint("127.0.0.1", PORT), own)}
    argv = [sys.executable, "-m", "poise", *words]
    with subprocess.Popen(argv, stdout=subprocess.DEVNULL) as agent:
        try:
            with Agents("idle", where, SystemClock(), keys=own) as agents:
                agents.wait_alive(where, 20)
                agents.claim(where)
                agents.wait_news(lambda: False, 2)
                before, began = cpu_of(agent.pid), time.monotonic()
                time.sleep(seconds)
                return (cpu_of(agent.pid) - before) / (time.monotonic() - began)
        finally:
            agent.terminate()


def in_turns(rounds: int, **measure: Callable[[], T]) -> list[dict[str, T]]:
    """Return the measurements of each round."""
    done = []
    for number in range(rounds):
        sys.stderr.write(f"round {number + 1} of {rounds}: {', '.join(measure)}\n")
        done.append({name: what() for name, what in measure.items()})
    return done


def measure(*, is_quick: bool) -> dict[str, float]:
    """Return what all costs."""
    rounds, calls, seconds = (1, 500, 3.0) if is_quick else (9, 4000, 20.0)
    with tempfile.TemporaryDirectory(prefix="poise-") as name:
        folder = Path(name)
        authority = init_keys("idle", folder / "owner")
        keys = str(authority.issue("left", "agent", folder / "owner" / "left").folder)
        small = in_turns(
            rounds,
            plain=lambda: small_call("Poise remote, call", calls),
            tls=lambda: small_call("Poise remote, call", calls, keys),
            zenoh=lambda: small_call("zenoh query", calls),
        )
        big = in_turns(
            min(rounds, 3),
            plain=lambda: large(seconds, is_encrypted=False),
            tls=lambda: large(seconds, is_encrypted=True),
        )
        cores = in_turns(
            min(rounds, 3),
            plain=lambda: idle(seconds, folder / "agent"),
            tls=lambda: idle(seconds, folder / "agent", keys),
        )
    found = {
        "call_64_b_plain_us": median(each["plain"] for each in small),
        "call_64_b_tls_us": median(each["tls"] for each in small),
        "zenoh_query_64_b_us": median(each["zenoh"] for each in small),
        "call_64_b_more_us": median(each["tls"] - each["plain"] for each in small),
        "call_64_b_of_zenoh_query": median(e["tls"] / e["zenoh"] for e in small),
    }
    for number, what in enumerate(("call_1_mb", "move_50_mb")):
        found |= {
            f"{what}_{kind}_s": median(each[kind][number] for each in big)
            for kind in ("plain", "tls")
        }
        quotients = (each["tls"][number] / each["plain"][number] for each in big)
        found[f"{what}_times"] = median(quotients)
    for kind in ("plain", "tls"):
        found[f"idle_agent_{kind}_cores"] = median(each[kind] for each in cores)
    found["idle_agent_more_cores"] = median(e["tls"] - e["plain"] for e in cores)
    return found


def main() -> None:
    """Measure all, and print it beside the limits."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.encryption", description=__doc__
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="a minute")
    options = parser.parse_args()
    found = measure(is_quick=options.quick)
    if options.json:
        print(json.dumps({"measured": found, "limits": LIMITS}, indent=2))
        return
    for name, value in found.items():
        limit = f"  at most {LIMITS[name]:g}" if name in LIMITS else ""
        print(f"{name:30} {value:10.4f}{limit}")


if __name__ == "__main__":
    main()
