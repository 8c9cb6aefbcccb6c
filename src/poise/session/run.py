"""Runs a task from nothing to a report, and leaves nothing behind."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from poise.manage.adaptation.facts import Facts
from poise.manage.deploy.deactivation import drain
from poise.manage.deploy.lost_computers import LostComputers
from poise.manage.deploy.running_components import Run
from poise.manage.journal import Journal, JournalEntry
from poise.manage.tasks.task_manager import TaskManager
from poise.model.robot import Robot
from poise.session.callbacks import Check, Say, log, nothing
from poise.session.launch.start import Sampling, Started, started
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import Placement
from poise.session.placing.repository import note_architectures
from poise.session.recordings.record_run import keeping
from poise.session.reports.history import History
from poise.session.reports.last_seen import LastSeen
from poise.session.reports.run_report import MeasuredRun, RunReport, reported
from poise.session.robot_file import task_of
from poise.session.watched_run import WatchedRun
from poise.wire.records.samples import AgentSample

Meanwhile = Callable[[Run, float], object]
"""Called a few times a second with the run and its time so far [s]; may move
components, and may raise to end the run."""


def run(  # noqa: PLR0913 - each is a choice of the user
    robot: Robot,
    task: str | None = None,
    *,
    seconds: float,
    placement: Placement | None = None,
    journal: Path | None = None,
    record: Path | None = None,
    say: Say = log.info,
    meanwhile: Meanwhile = lambda *_: None,
    check: Check = nothing,
) -> RunReport:
    """Run a task until it is over, or some time or the simulated world is, and report.

    At the end all components are deactivated from sources to targets, so that the
    report has the final counts. Ctrl-C (`KeyboardInterrupt`) ends it early, and the
    report says so; the same while it starts is raised. An agent that is killed and
    started again ends nothing.

    Parameters
    ----------
    task
        Its name; None: the robot's first.
    seconds
        How long at most [s].
    placement
        What `poise.place` decided; None: it is decided here.
    journal
        A file for every decision (SQLite); None: it is not kept.
    record
        A file for what is used and what is published between architectures; None: it
        is not kept.
    say
        Takes a sentence at every step.
    meanwhile
        Called a few times a second with the run and its time so far [s].
    check
        Called several times a second; may raise `KeyboardInterrupt`.

    Raises
    ------
    RobotError, RunError
        It cannot start, a component failed or a computer was lost; everything is down
        again.
    """
    chosen = task_of(robot, task)
    sentences: list[str] = []
    first = first_phase(robot, [chosen], placement, sentences.append)
    placed = first.placed
    with contextlib.ExitStack() as stack:
        at = time.time()
        book = Journal(journal or ":memory:", _saying(say))
        stack.callback(book.close)
        book.note("decided", f"task '{chosen}', {placed.method} placement")
        for sentence in sentences:
            book.note("decided", sentence)
        note_architectures(book, robot, placed)
        for name in placed.result.aside:
            sentence = f"architecture '{name}' is put aside: {placed.why_aside}"
            book.note("wrong", sentence)
        watched = WatchedRun(robot)
        is_served = stack.enter_context(watched.served(robot.name, say))
        kept = stack.enter_context(keeping(robot, placed.where, record, say))

        def take(sample: AgentSample) -> None:
            watched.samples.add(sample)
            if record is not None:
                kept.samples.add(sample)

        def look(run: Run, now: float) -> None:
            watched.look()
            meanwhile(run, now)

        sampling = Sampling(take)
        up = stack.enter_context(
            started(kept.robot, placed.where, book, say, sampling, check, use_kept=True)
        )
        shows = "; `poise top` and `poise dashboard` show it" if is_served else ""
        say(f"running task '{chosen}' for up to {seconds:g} s{shows}")
        tasks = TaskManager(up.run, first.tasks.saved, partial(_facts, up.run))
        watched.begin(up.run, tasks)
        around = _with_agents(up.run, check, look)
        seen = _measure(up, seconds, around, partial(_look, tasks, first.aside()))
        drain(up.run)
        entries = tuple(entry for entry in book.entries() if entry.at >= at)
        return reported(up, placed, tasks.reports, seen, entries)


def _saying(say: Say) -> Callable[[JournalEntry], object]:
    """Return what says the entries about what is wrong, and that it is right again."""
    return lambda each: say(str(each)) if each.kind in {"wrong", "right"} else None


def _with_agents(run: Run, check: Check, meanwhile: Meanwhile) -> Meanwhile:
    """Return what also goes on with agents that were killed and are started again.

    A computer that is lost ends the run.
    """
    lost = LostComputers(run)

    def look() -> None:
        check()
        lost.note()
        run.excused -= lost.computers()

    def look_around(run: Run, now: float) -> None:
        lost.bring_back()
        meanwhile(run, now)

    run.check = look
    return look_around


def _facts(run: Run) -> Facts:
    """Return what is known without estimates: enough for most conditions."""
    lost = frozenset(run.agents.out_of_reach())
    return Facts(
        robot=run.robot,
        task="",
        placement=run.placement(),
        lost=lost,
        statuses=run.current(),
    )


def _look(tasks: TaskManager, aside: frozenset[str]) -> bool:
    """Look at the tasks; return whether all are over."""
    tasks.look(aside)
    return tasks.is_over()


def _measure(
    up: Started, seconds: float, meanwhile: Meanwhile, is_over: Callable[[], bool]
) -> MeasuredRun:
    up.computers.begin()
    begin, began, at = up.run.agents.statuses(), time.monotonic(), time.time()
    history, last_seen = History(up.run.robot, up.computers.faster), LastSeen()
    interrupted = False

    def look(_: float) -> None:
        now, statuses = time.monotonic(), up.run.agents.statuses()
        last_seen.look(statuses)
        history.look(statuses, time.time(), now)
        meanwhile(up.run, now - began)

    try:
        up.watch(seconds, look, is_over)
    except KeyboardInterrupt:
        interrupted = True
    return MeasuredRun(
        begin=begin,
        end=up.run.agents.statuses(),
        began=at,
        history=tuple(history.moments),
        last_seen=last_seen,
        seconds=time.monotonic() - began,
        invalid=up.computers.end(),
        interrupted=interrupted,
    )
