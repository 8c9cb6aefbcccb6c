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
    FULL,
    NAVIGATOR,
    Scene,
    drive_once,
    failed_functions,
    fill,
    find_trouble,
    goal_sentence,
    is_at_goal,
    late_share,
    load_trot,
    missed_share,
    move_while_driving,
    time_calls,
    too_busy,
)
from examples.demo.picture import DrivePicture, drives_picture
from examples.demo.scenes import SCENES
from poise import RunReport, load
from poise.cli.main import Interrupts
from poise.cli.options import print_json
from poise.emulate import full_speed
from poise.session.folders import scratch_folder
from poise.session.launch.printer import STDERR, Printer
from poise.session.render.tables import table
from poise.units import format_seconds
from poise.wire.records.status_records import Summary

EXAMPLES = Path(__file__).parents[1]
TITLES = {"static": "As in the paper", "auto": "Poise"}
"""By method."""
_HEADINGS = {
    "static": "As in the paper: each function on its computer, all of one priority",
    "auto": "Poise: each component where the planner puts it, by priority",
}
TOO_BUSY = 2
"""The exit code when the machine cannot emulate two computers now."""
_LEARNED = shutil.ignore_patterns(".poise", "__pycache__")
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
    console.print(
        "T-Rot, a home robot: 25 components on two computers that this machine "
        "emulates\nTo watch, run in another terminal: "
        f"{_this_poise()} dashboard",
        soft_wrap=True,
    )
    with (
        Interrupts() as interrupts,
        full_speed(),
        scratch_folder("poise-demo-") as folder,
    ):
        check = interrupts.check
        # in a copy, for what drives teach of its functions is not to last
        shutil.copytree(EXAMPLES / "trot", folder / "trot", ignore=_LEARNED)
        console.print("Measuring what the components need on this machine ...")
        profiled = load_trot(folder)
        robot = fill(profiled, console, check)
        computer = robot.emulated.computers[0]
        console.print(
            f"Poise's placement fills them to {FULL:.0%} when each gets "
            f"{computer.speed:.0%} of a core."
        )
        runs = []
        for number, (method, heading) in enumerate(_HEADINGS.items(), 1):
            console.print(f"\n[bold]{number}. {heading}")
            runs.append(drive_once(robot, method, console, check))
        console.print("\n[bold]3. The localiser moves while the robot drives")
        scene = move_while_driving(profiled, console, check)
        calls = time_calls(EXAMPLES, console, check)
    shown = DemoReport(runs=tuple(runs), scene=scene, calls=calls)
    if as_json:
        print_json(shown)
    else:
        _show(shown, console)
    _draw(shown.runs, console)
    if busy := too_busy(shown.runs):
        Console(stderr=True).print(f"too busy: {busy}")
        raise typer.Exit(TOO_BUSY)
    if trouble := find_trouble(shown.runs):
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
    rows = table("", *(TITLES[drive.method] for drive in report.runs))
    for label, read in _ROWS.items():
        rows.add_row(label, *(read(drive) for drive in report.runs))
    for computer in report.runs[0].cpu_share:
        shares = [f"{drive.cpu_share.get(computer, 0):.0%}" for drive in report.runs]
        rows.add_row(f"CPU used on {computer}", *shares)
    console.print()
    console.print(rows)
    near, far = (format_seconds(each.median) for each in report.calls.values())
    console.print(
        f"A call takes {near} in one process, {far} to the other computer (medians; "
        "paper: 6 µs without a framework, 74 µs by message). The paper's decision took "
        "42 µs. Placed by hand, but with Poise's priorities, the navigator arrives, "
        "and others fail: `python -m benchmarks.experiment` compares ten ways."
    )


def _draw(runs: Sequence[RunReport], console: Console) -> None:
    picture = drives_picture([_picture_of(drive) for drive in runs])
    _PICTURE.write_text(picture, encoding="utf-8")
    console.print(f"Both drives as a picture: {_PICTURE.absolute()}", soft_wrap=True)


def _picture_of(drive: RunReport) -> DrivePicture:
    return DrivePicture(
        title=TITLES[drive.method],
        verdict=f"goal {goal_sentence(drive)}",
        is_good=is_at_goal(drive),
        world=drive.simulation,
        cpu=drive.cpu_share,
        placement=drive.placement,
        late=late_share(drive, "pose"),
    )


def _typical(summary: Summary) -> str:
    return f"{format_seconds(summary.median)} (p99 {format_seconds(summary.p99)})"


def _age(report: RunReport, what: str) -> str:
    measures = report.component(NAVIGATOR).measures
    return _typical(measures.get(f"{what}_age", Summary()))


def _functions(report: RunReport) -> str:
    failed = len(failed_functions(report))
    every = len(report.simulation.get("functions", {}))
    return f"{every - failed} of {every}"


_ROWS: Mapping[str, Callable[[RunReport], str]] = {
    "goal": goal_sentence,
    "functions that worked": _functions,
    "pose too old (200 ms)": lambda r: f"{late_share(r, 'pose'):.0%} of checks",
    "map too old (300 ms)": lambda r: f"{late_share(r, 'map'):.0%} of checks",
    "age of the pose": lambda r: _age(r, "pose"),
    "age of the map": lambda r: _age(r, "map"),
    "navigator's cycles late": lambda r: f"{missed_share(r):.0%}",
    "placement decided": lambda r: (
        f"in {format_seconds(r.decision_seconds)}" if r.decision_seconds else "by hand"
    ),
}

OUTPUTS = [
    DemoReport,
    *dict.fromkeys(get_type_hints(play)["return"] for _, play in SCENES.values()),
]
"""What `poise demo --json` prints, one of these."""
