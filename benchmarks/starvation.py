"""How exactly an emulation tells that the host kept CPU from it.

Every process here wants CPU all the time, so the truth is known: what is neither used
nor throttled was starved. Run it where processes
can be limited (root, or a delegated cgroup).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from poise.emulate import EmulatedComputer, Emulation, probe_host
from poise.model import Computer, Robot

WINDOW = 2.0
BURN = "while True: pass"
ROW = "{:44} {:>6} {:>6} {:>9} {:>8} {:>8} {:>6}  {}"
# (what, quotas of the computers, all on one CPU; burning processes beside them)
SITUATIONS = (
    ("alone, quota 0.5", (0.5,), 0),
    ("alone, quota 0.9", (0.9,), 0),
    ("alone, a whole CPU", (1.0,), 0),
    ("quota 0.5, beside 3 busy processes", (0.5,), 3),
    ("quota 0.9, beside 3 busy processes", (0.9,), 3),
    ("quota 0.4, beside another computer's 0.4", (0.4, 0.4), 0),
    ("quota 0.9, beside 2 more of 0.9", (0.9, 0.9, 0.9), 0),
)


@contextmanager
def busy(cpu: int, number: int) -> Iterator[None]:
    """Keep `cpu` busy with processes that belong to no computer."""
    argv = ["taskset", "--cpu-list", str(cpu), sys.executable, "-c", BURN]
    others = [subprocess.Popen(argv) for _ in range(number)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def wait_busy(computer: EmulatedComputer) -> None:
    """Wait until the program in the computer has begun to burn CPU."""
    end = time.monotonic() + 10
    while computer.usage().used < 0.1 and time.monotonic() < end:
        time.sleep(0.01)


def measure(what: str, quotas: tuple[float, ...], others: int) -> None:
    """Print a line about the first computer of a robot on one CPU."""
    host = msgspec.structs.replace(probe_host(), cpus=probe_host().cpus[-1:])
    computers = tuple(
        Computer(name=f"c{number}", capacity={"cpu": quota})
        for number, quota in enumerate(quotas)
    )
    with (
        tempfile.TemporaryDirectory() as folder,
        busy(host.cpus[0], others),
        Emulation(Robot(name="r", computers=computers), Path(folder), probe=host) as e,
    ):
        for computer in e.computers.values():
            computer.popen([sys.executable, "-c", BURN])
            wait_busy(computer)
        first = e.computers["c0"]
        before, begin = first.usage(), time.monotonic()
        time.sleep(WINDOW)
        after, wall = first.usage(), time.monotonic() - begin
        if before.starved is None or after.starved is None:
            sys.exit("this kernel does not tell a cgroup's CPU pressure")
        used = after.used - before.used
        throttled = after.throttled - before.throttled
        starved = after.starved - before.starved
        truth = max(0.0, wall - used - throttled)
        cells = (used, throttled, starved, truth, starved - truth)
        rate = used / (used + starved)
        verdict = "void" if first.was_starved(before, after) else "counts"
        numbers = [f"{cell / wall:.3f}" for cell in cells]
        print(ROW.format(what, *numbers, f"{rate:.2f}", verdict))


def main() -> None:
    """Measure all situations."""
    argparse.ArgumentParser(
        "python -m benchmarks.starvation", description=__doc__
    ).parse_args()
    print(f"shares of {WINDOW:g} s; speed: of a host CPU, while not throttled")
    heads = ("used", "thrott", "starved", "truth", "error", "speed", "a run")
    print(ROW.format("", *heads))
    for situation in SITUATIONS:
        measure(*situation)


if __name__ == "__main__":
    main()
