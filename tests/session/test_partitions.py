"""Three computers that are cut apart: what goes on where, and nothing twice."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

import poise
from examples.demo.waiting import measures
from poise.emulate import EmulatedSet, probe_host
from poise.session.placing.placement import place
from poise.session.running_robots.running import Running
from tests.waiting import LONG, wait_long

pytestmark = [pytest.mark.slow, pytest.mark.timeout(LONG)]

COUNTED = Path(__file__).parents[2] / "examples" / "counted"
TICKER = """
import os, time
from pathlib import Path
from poise import Component, every

class Ticker(Component):
    @every(0.02)
    def tick(self):
        with Path(self.parameters["folder"], str(os.getpid())).open("a") as file:
            file.write(f"{time.monotonic()}\\n")
"""
TICKING = """
  ticking:
    function: ticking
    components:
      ticker: {implementation: 'ticker:Ticker', cpu: 2%, parameters: """
_NOBODY = "02:00:00:00:00:00"


@pytest.fixture(scope="module", autouse=True)
def _needs_namespaces() -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))


def counted(folder: Path) -> poise.Robot:
    """Return the example with a third computer, and a component that notes its time."""
    shutil.copy(COUNTED / "counted.py", folder)
    (folder / "ticker.py").write_text(TICKER)
    ticks = folder / "ticks"
    ticks.mkdir()
    text = (COUNTED / "robot.yaml").read_text()
    for old, new in (
        ("robot: counted", f"robot: partitions-{os.getpid()}"),
        ("  right:", "  third: {cpu: 0.4, memory: 1 GiB}\n  right:"),
        ("cpu: 0.8", "cpu: 0.4"),
        ("architectures:\n", f"architectures:\n{TICKING}{{folder: {ticks}}}}}\n"),
        ("functions: [counting]", "functions: [counting, ticking]"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "robot.yaml").write_text(text)
    return poise.load(folder / "robot.yaml")


def ticks(folder: Path) -> list[tuple[float, str]]:
    """Return when the component ticked, in which process."""
    return sorted(
        (float(line), file.name)
        for file in (folder / "ticks").iterdir()
        for line in file.read_text().split("\n")[:-1]
    )


def cut_from_manager(kept: EmulatedSet, computer: str) -> Callable[[], None]:
    """Let what a computer sends to the manager alone vanish; return what heals it."""
    network = kept.layout.network
    assert network is not None
    names = [each.name for each in kept.layout.computers]
    namespace = network.cables[names.index(computer)].namespace

    def neighbour(*words: str) -> None:
        address = network.owner_address
        subprocess.run(
            ["ip", "-n", namespace, "neigh", *words[:1], address, *words[1:]],
            check=True,
            timeout=10,
        )

    neighbour("replace", "lladdr", _NOBODY, "nud", "permanent", "dev", "eth0")
    return lambda: neighbour("del", "dev", "eth0")


def at(running: Running, component: str) -> str:
    return running.status().placement[component]


def is_well(running: Running) -> bool:
    status = running.status()
    return not status.deviations and not status.out_of_reach


def test_nothing_is_active_twice_whoever_is_cut_off(tmp_path: Path) -> None:
    robot = counted(tmp_path)
    with (
        poise.emulated(robot, say=print) as kept,
        poise.up(robot, placement=place(robot, method="static"), say=print) as up,
    ):
        up.move("ticker", "right")
        wait_long(lambda: is_well(up) and measures(up).get("received", 0) > 100)
        # from the manager alone: another computer hears it, so it goes on
        heal = cut_from_manager(kept, "right")
        wait_long(lambda: "right" in up.status().out_of_reach)
        begun = len(ticks(tmp_path))
        wait_long(lambda: len(ticks(tmp_path)) > begun + 100)
        assert at(up, "ticker") == "right"
        heal()
        wait_long(lambda: is_well(up))
        # before its move
        assert len({process for _, process in ticks(tmp_path)}) == 2
        # from all: it goes on elsewhere, and only there
        kept.cut("right")
        wait_long(lambda: at(up, "ticker") != "right")
        begun = len(ticks(tmp_path))
        wait_long(lambda: len(ticks(tmp_path)) > begun + 100)
        kept.heal("right")
        wait_long(lambda: is_well(up))
        before = measures(up)["received"]
        wait_long(lambda: measures(up)["received"] > before + 200)
        counts = measures(up)
    assert (counts["doubled"], counts["reordered"]) == (0, 0)
    changes = [b for (_, a), (_, b) in pairwise(ticks(tmp_path)) if a != b]
    assert len(changes) == 2  # by the move, and from the computer that was cut off
