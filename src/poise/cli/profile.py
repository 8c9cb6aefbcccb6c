"""`poise profile`: measure what each component needs."""

from __future__ import annotations

import datetime as dt
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from poise.cli.options import parse_option
from poise.cli.render.profile import history_table, show_profile
from poise.errors import RobotError, UsageError
from poise.estimate.predict import overheads
from poise.estimate.profile import Profile
from poise.estimate.profile import file as profile_file
from poise.estimate.profile.version import version_of
from poise.manage.observe.profiling import (
    Figures,
    Observed,
    Subject,
    disagreeing,
    figures,
)
from poise.model.robot import Robot
from poise.session.measure_alone import Tick, measure_alone
from poise.session.profiles import check_keepable, read_profile, stale, store_of
from poise.session.profiling_rig import EMPTY, ProfilingRig, stand_of
from poise.session.robot_file import load_bare
from poise.session.writable import to_write
from poise.session.write_demands import write_demands
from poise.units import SECONDS

_MOST_EXTRA = 2
"""Measurements that disagree, or that the machine spoilt, are repeated so often."""


def profile_command(
    file: Annotated[
        Path, typer.Argument(help="The robot file; or `show`, then the robot file.")
    ],
    shown: Annotated[Path | None, typer.Argument(hidden=True)] = None,
    architecture: Annotated[
        list[str] | None, typer.Option(help="Measure only this one; may be repeated.")
    ] = None,
    for_: Annotated[
        str, typer.Option("--for", help="How long to measure each time.")
    ] = "30s",
    warm_up: Annotated[str, typer.Option(help="How long to run before.")] = "3s",
    on: Annotated[
        str | None, typer.Option(help="The computer to measure on; else the first.")
    ] = None,
    repeat: Annotated[
        int, typer.Option(min=1, help="How often to measure each architecture.")
    ] = 2,
    write: Annotated[
        bool, typer.Option("--write", help="Write demands into the robot file, too.")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="For show: draw it into a .svg, .png or .pdf file.", callback=to_write
        ),
    ] = None,
    history: Annotated[
        bool, typer.Option("--history", help="For show: beside earlier profiles.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the profile as JSON.")
    ] = False,
) -> None:
    """Measure what each component needs, every architecture alone on one computer.

    What was measured goes into the profile that the robot file names, where `poise
    plan` and all others find it, and into a store beside it that keeps older ones.
    `poise profile show robot.yaml` prints the last one and measures nothing; it draws
    it (`--plot`), and compares it with earlier ones (`--history`).

    Examples
    --------
    poise profile robot.yaml --for 30s
    poise profile show robot.yaml --plot profile.svg
    """
    console = Console(stderr=as_json, highlight=False)
    if str(file) == "show":
        _show(shown, console, as_json=as_json, plot=plot, history=history)
        return
    if plot is not None or history:
        raise UsageError("--plot and --history are for `poise profile show`")
    if shown is not None:
        raise UsageError(f"{shown}: give one robot file, or `show` and a robot file")
    robot = load_bare(file)
    names = _chosen(robot, architecture or [])
    check_keepable(robot)
    session = _Session(
        robot,
        on or robot.computers[0].name,
        parse_option("--for", for_, SECONDS),
        parse_option("--warm-up", warm_up, SECONDS),
        repeat,
        console,
    )
    found = [session.measure(name) for name in names]
    profile = _merged(session.profile(found), read_profile(robot), robot)
    with store_of(robot) as store:
        if not profile.costs:
            costs = store.latest_costs(robot.name)
            profile = msgspec.structs.replace(profile, costs=costs)
        store.add(profile)
    where = _write(robot, profile)
    _print(robot, profile, console, as_json=as_json)
    console.print(where)
    if write:
        changed = write_demands(file, profile)
        console.print(f"demands written to {', '.join(map(str, changed)) or 'no file'}")


def _show(
    file: Path | None,
    console: Console,
    *,
    as_json: bool,
    plot: Path | None,
    history: bool,
) -> None:
    if file is None:
        raise UsageError("give a robot file, as in `poise profile show robot.yaml`")
    robot = load_bare(file)
    profile = read_profile(robot)
    with store_of(robot) as store:
        profile = profile or store.latest(robot.name)
        earlier = store.all(robot.name) if history else []
    if profile is None:
        raise RobotError(
            f"robot '{robot.name}' has no profile: `poise profile {file}` measures it"
        )
    _print(robot, profile, console, as_json=as_json)
    if history:
        console.print(history_table(profile, earlier))
    if plot is not None:
        from poise.view.profile_plot import plot_profile

        plot_profile(profile, overheads(robot, profile), plot)
        console.print(f"drawn to {plot}")


def _print(robot: Robot, profile: Profile, console: Console, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(profile).decode() + "\n")
        return
    show_profile(robot, profile, console)
    old = stale(robot, profile)
    if old:
        console.print(f"[yellow]changed since it was measured: {', '.join(old)}[/]")


def _chosen(robot: Robot, names: Sequence[str]) -> list[str]:
    known = [a.name for a in robot.architectures]
    unknown = [name for name in names if name not in known]
    if unknown or not known:
        raise UsageError(
            f"--architecture {', '.join(unknown)}: the robot has "
            f"{', '.join(known) or 'none'}"
        )
    return list(names) or known


class _Session:
    """One use of the command: measures architectures, one after the other."""

    def __init__(
        self,
        robot: Robot,
        computer: str,
        seconds: float,
        warm_up: float,
        repeat: int,
        console: Console,
    ) -> None:
        if not seconds > 0:
            raise UsageError("--for: a measurement lasts longer than 0 s")
        self._robot = robot
        self._computer = computer
        self._seconds = seconds
        self._warm_up = warm_up
        self._repeat = repeat
        self._console = console

    def measure(self, architecture: str) -> Figures:
        """Measure one architecture: as it is used, and with its components apart."""
        stand = stand_of(self._robot, architecture, self._computer, apart=False)
        apart = stand_of(self._robot, architecture, self._computer, apart=True)
        with self._progress(architecture) as progress:
            total = (self._repeat + 1) * (self._seconds + self._warm_up)
            bar = progress.add_task(architecture, total=total)

            def tick(seconds: float) -> None:
                progress.advance(bar, seconds)

            runs = self._runs(stand, tick)
            sizes = self._run(apart, tick)
        doubtful = disagreeing(runs, stand.measured)
        if doubtful:
            self._console.print(
                f"[yellow]not stable after {len(runs)} measurements: "
                f"{', '.join(doubtful)}[/]"
            )
        subject = Subject(
            robot=self._robot,
            computer=self._computer,
            names=stand.measured,
            empty=EMPTY,
            versions={
                c.name: version_of(c, self._robot.folder)
                for c in self._robot.components()
            },
            speed=self._speed(),
            played=stand.played,
        )
        return figures(subject, runs, sizes)

    def profile(self, found: Sequence[Figures]) -> Profile:
        """Return the profile of all that was measured."""
        return Profile(
            robot=self._robot.name,
            poise=version("poise"),
            computer=self._computer,
            speed=self._robot.computer(self._computer).speed,
            at=dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
            seconds=self._seconds,
            agent=max(each.agent for each in found),
            components={n: c for each in found for n, c in each.components.items()},
            connectors={n: c for each in found for n, c in each.connectors.items()},
        )

    def _runs(self, stand: ProfilingRig, tick: Tick) -> list[Observed]:
        runs: list[Observed] = []
        for attempt in range(self._repeat + _MOST_EXTRA):
            run = self._run(stand, tick)
            if not run.invalid or attempt == self._repeat + _MOST_EXTRA - 1:
                runs.append(run)
            if len(runs) >= self._repeat and not disagreeing(runs, stand.measured):
                break
        return runs

    def _run(self, stand: ProfilingRig, tick: Tick) -> Observed:
        run = measure_alone(stand, self._seconds, self._warm_up, _silent, tick)
        if run.invalid:
            self._console.print(f"[yellow]{run.invalid}[/]")
        return run

    def _speed(self) -> float:
        """Return what turns the computer's CPU time into the reference computer's."""
        if all(c.address is None for c in self._robot.computers):
            # an emulated one of speed 0.5 runs half of the time, at full speed
            return 1.0
        return self._robot.computer(self._computer).speed

    def _progress(self, architecture: str) -> Progress:
        self._console.print(f"measuring {architecture} on {self._computer}")
        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
        )


def _silent(_: str) -> None:
    """Say nothing: the progress bar speaks."""


def _merged(new: Profile, old: Profile | None, robot: Robot) -> Profile:
    """Return the new profile with what an older one knows of other components.

    What was measured on another computer, or of components that are gone, is dropped.
    """
    if old is None or (old.computer, old.robot) != (new.computer, new.robot):
        return new
    names = {c.name for c in robot.components()}
    kept = {n: c for n, c in old.components.items() if n in names}
    connectors = {str(c) for c in robot.all_connectors()}
    joined = {n: c for n, c in old.connectors.items() if n in connectors}
    return msgspec.structs.replace(
        new,
        components={**kept, **new.components},
        connectors={**joined, **new.connectors},
        costs=old.costs,
    )


def _write(robot: Robot, profile: Profile) -> str:
    """Write the file that the robot file names; return a sentence about it."""
    if not robot.profile:
        return (
            "kept in the store; add `profile: profile.yaml` to the robot file and the "
            "planner will use it"
        )
    path = Path(robot.folder) / robot.profile
    path.write_text(profile_file.to_text(profile), "utf-8")
    return f"written to {path}"
