"""The paper's case study, with static placement and with Poise's; and the scenes.

It imports internal modules: it is the command `poise demo`.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import get_type_hints

import msgspec
import typer
from msgspec import Struct
from rich.console import Console

from examples.demo.drives import (
    NAVIGATOR,
    Scene,
    drive_once,
    failed_functions,
    find_trouble,
    is_at_goal,
    missed_share,
    move_while_driving,
    time_calls,
    told,
)
from examples.demo.picture import DrivePicture, drives_picture
from examples.demo.scenes import SCENES
from poise.cli.interrupts import Interrupts
from poise.cli.options import print_json
from poise.emulate import full_speed
from poise.session.folders import scratch_folder
from poise.session.launch.printer import STDERR, Printer
from poise.session.render.tables import table
from poise.session.robot_file import load
from poise.session.run_report import RunReport
from poise.units import format_seconds
from poise.wire.records.status_records import Summary

EXAMPLES = Path(__file__).parents[1]
_TITLES = {"static": "static (by hand)", "auto": "Poise"}
_PICTURE = Path("poise-demo.svg")


class DemoReport(Struct, frozen=True, kw_only=True):
    """All that the demo measured.

    Parameters
    ----------
    runs
        Two drives: placed by hand, and by Poise.
    calls
        How long calls take: in one container, and between two computers [s].
    """

    runs: tuple[RunReport, ...]
    scene: Scene
    calls: Mapping[str, Summary]


def play_drives(*, as_json: bool) -> None:
    """Drive twice, move a component while driving, time calls; show and draw it all."""
    console = Console(stderr=as_json, highlight=False)
    poise = _this_poise()
    console.print(
        f"To watch it live, run in another terminal:\n  {poise} dashboard   # or: top",
        soft_wrap=True,
    )
    with Interrupts() as interrupts, full_speed():
        check = interrupts.check
        shown = DemoReport(
            runs=tuple(drive_once(EXAMPLES, each, console, check) for each in _TITLES),
            scene=move_while_driving(EXAMPLES, console, check),
            calls=time_calls(EXAMPLES, console, check),
        )
    print_json(shown) if as_json else _show(shown, console)
    _draw(shown.runs, console)
    console.print(
        "to watch T-Rot for longer:\n"
        f"  {poise} up {EXAMPLES / 'trot' / 'robot.yaml'} --dashboard",
        soft_wrap=True,
    )
    trouble = find_trouble(shown.runs)
    if trouble:
        Console(stderr=True).print(trouble)
        raise typer.Exit(1)


def _this_poise() -> str:
    """Return how this `poise` is started in any folder."""
    path = Path(sys.executable).with_name("poise")
    is_known = shutil.which("poise") == str(path) or not path.exists()
    return "poise" if is_known else str(path)


def play_scene(scene: str, *, as_json: bool) -> None:
    """Play a scene on a copy of its example, and print what it measured."""
    with Printer(STDERR) as printer, Interrupts() as interrupts:
        example, play = SCENES[scene]
        with scratch_folder("poise-demo-") as folder:
            file = _renamed(EXAMPLES / example, folder / example)
            robot = load(file, say=printer.print)
            report = play(robot, printer.print, interrupts.check)
    if as_json:
        print_json(report)
    else:
        for key, value in msgspec.structs.asdict(report).items():
            Console(highlight=False).print(f"{key:16}{value}")
    if not report.ok:
        raise typer.Exit(1)


def _renamed(example: Path, folder: Path) -> Path:
    """Return the robot file in a copy of an example, with a name of its own.

    Emulated computers and managers are found by it, and another may be up.
    """
    file = shutil.copytree(example, folder) / "robot.yaml"
    old, new = f"robot: {example.name}\n", f"robot: {example.name}-{os.getpid()}\n"
    file.write_text(file.read_text(encoding="utf-8").replace(old, new, 1))
    return file


def _show(report: DemoReport, console: Console) -> None:
    """Print the numbers side by side, a column per run."""
    rows = table("", *(_TITLES[drive.method] for drive in report.runs))
    for computer in report.runs[0].cpu_share:
        shares = [f"{drive.cpu_share.get(computer, 0):.0%}" for drive in report.runs]
        rows.add_row(f"CPU used on {computer}", *shares)
    for label, read in _ROWS.items():
        rows.add_row(label, *(read(drive) for drive in report.runs))
    console.print(rows)
    console.print(told(report.scene))
    direct, message = map(_typical, report.calls.values())
    console.print(f"a call to a component beside it: {direct}")
    console.print(f"a call to one on the other computer: {message}")
    console.print(_ABOUT_TIMES)


def _draw(runs: Sequence[RunReport], console: Console) -> None:
    drives = [
        DrivePicture(
            title=_TITLES[drive.method],
            path=drive.simulation.get("path", ()),
            shares={"deadlines missed": missed_share(drive)}
            | {f"CPU of {name}": share for name, share in drive.cpu_share.items()},
            verdict="functions that failed: "
            + (", ".join(failed_functions(drive)) or "none"),
        )
        for drive in runs
    ]
    home = runs[-1].simulation
    goal = [home["goal"]] if "goal" in home else []
    picture = drives_picture(drives, home.get("walls", ()), goal)
    _PICTURE.write_text(picture, encoding="utf-8")
    console.print(f"both drives are drawn in {_PICTURE.absolute()}")


_ABOUT_TIMES = """
What the times include, and what the paper says of its own:
- decision: the search for all components, once demands are known.
  Paper: 42 µs on the average for its greedy; it does not say whether that
  begins with the demands.
- near call: through a connector, there and back, in one process.
  Paper: 6 µs on the average for a direct method call, without a framework.
- far call: there and back, encoded, through two processes and the emulated
  link. Paper: 74 µs by message passing through a connector; it does not say
  between which computers.
"""


def _typical(summary: Summary) -> str:
    return f"{format_seconds(summary.median)} (p99 {format_seconds(summary.p99)})"


def _age(report: RunReport, what: str) -> str:
    measures = report.component(NAVIGATOR).measures
    return _typical(measures.get(f"{what}_age", Summary()))


_ROWS: Mapping[str, Callable[[RunReport], str]] = {
    "200 ms deadlines missed": lambda r: f"{missed_share(r):.1%}",
    "age of the pose used, median (p99)": lambda r: _age(r, "pose"),
    "age of the map used, median (p99)": lambda r: _age(r, "map"),
    "goal reached": lambda r: "yes" if is_at_goal(r) else "no",
    "functions that failed": lambda r: ", ".join(failed_functions(r)) or "none",
    "time": lambda r: f"{r.seconds:.1f} s",
    "placement decided in": lambda r: (
        format_seconds(r.decision_seconds) if r.decision_seconds else "by hand"
    ),
    "valid run": lambda r: "no" if r.invalid else "yes",
}

OUTPUTS = [
    DemoReport,
    *dict.fromkeys(get_type_hints(play)["return"] for _, play in SCENES.values()),
]
"""What `poise demo --json` prints, one of these."""
