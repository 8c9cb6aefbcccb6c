"""A robot that runs, with its manager and journal, and what standbys have to know."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct
from msgspec.msgpack import encode

from poise import threads
from poise.errors import PoiseError
from poise.estimate.outcomes import note_outcome
from poise.manage.deploy.live_robot import DoesNotStart, LiveRobot
from poise.manage.journal import Journal, JournalEntry, check_journal
from poise.manage.manager import Manager
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording, RecordingFile
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.saved_tasks import goes_on_with
from poise.model.robot import Robot
from poise.session import Check, Say
from poise.session.folders import make_journal
from poise.session.launch.computers import Computers, outlive_manager
from poise.session.launch.start import Sampling, Started, started
from poise.session.placing.first_phase import FirstPhase, note_architectures
from poise.session.profiling.stored_profiles import read_profile
from poise.wire.records.request_records import Election


class StandbySetup(Struct, frozen=True, kw_only=True):
    """What a standby has to know of the robot that it may lead."""

    robot: Robot
    adapts: bool = True


def election_of(robot: Robot, *, adapts: bool) -> Election | None:
    """Return how managers follow each other; None: the computers end with them."""
    if not robot.standbys or not outlive_manager(robot):
        return None
    return Election(
        votes=robot.votes,
        managers=robot.standbys,
        setup=encode(StandbySetup(robot=robot, adapts=adapts)),
    )


def without_standbys(robot: Robot) -> str:
    """Return what a person should know of a real robot that has none; empty: it has."""
    real = [computer.name for computer in robot.hosts if computer.address]
    if robot.standbys or len(real) == 1 or not real:
        return ""
    if robot.manager is not None:
        cure = "name some in `manager`, so that one of them leads then"
    else:
        cure = "a witness, or `keeps` in the robot file, lets the other one lead then"
    return (
        "without standbys: when the computer of this manager dies, its components "
        f"stay down until the next `poise up`; {cure}"
    )


@contextlib.contextmanager
def journal_of(
    robot: Robot,
    first: FirstPhase,
    path: str | PathLike[str] | None,
    show: Callable[[JournalEntry], object],
    decided: Sequence[str],
) -> Iterator[Journal]:
    """Keep the journal of a robot, which begins with why it is placed as it is."""
    file = None if path is None else Path(path)
    check_journal(file)
    journal = Journal(make_journal(robot.name, file), show)
    try:
        for sentence in decided:
            journal.note("decided", sentence)
        note_architectures(journal, robot, first.placed)
        yield journal
    finally:
        journal.close()


class ToManage(NamedTuple):
    """A robot that is to be managed, and what its manager begins with.

    `where`: component -> computer, of what it starts; empty: it goes on with what runs.
    `election`, `computers`: as for `started`.
    """

    robot: Robot
    where: Mapping[str, str]
    tasks: Tasks
    why_suspended: str = ""
    election: Election | None = None
    computers: Computers | None = None


def planned(
    robot: Robot, first: FirstPhase, election: Election | None = None
) -> ToManage:
    """Return a robot that begins with a plan."""
    placed = first.placed
    return ToManage(
        robot, placed.where, first.tasks, placed.why_suspended, election=election
    )


@contextlib.contextmanager
def managed(
    what: ToManage,
    journal: Journal,
    say: Say,
    check: Check,
    *,
    adapts: bool,
    recorder: RecordingFile | None,
    begin: Callable[[LiveRobot], object] | None = None,
) -> Iterator[tuple[Started, Manager]]:
    """Start a robot with a manager, which nobody calls yet; stop it afterwards."""
    samples, robot = Recording(), what.robot
    sampling = Sampling(samples.add)
    with (
        _blamed(what, journal),
        started(
            robot,
            what.where,
            journal,
            say,
            sampling,
            check,
            use_kept=True,
            begin=begin,
            tasks=encode(what.tasks.saved),
            election=what.election,
            found=what.computers,
        ) as up,
    ):
        manager = Manager(
            up.live,
            goes_on_with(up.live, what.tasks, journal),
            Estimates(robot, read_profile(robot), emulated=robot.is_emulated),
            samples,
            adapts=adapts,
            suspended=what.why_suspended,
            recording=recorder,
        )
        with threads.failures_heard(manager.troubles.note_failure):
            yield up, manager


@contextlib.contextmanager
def _blamed(what: ToManage, journal: Journal) -> Iterator[None]:
    """Learn which architecture is to blame when the first actions cannot begin."""
    try:
        yield
    except DoesNotStart as error:
        blamed = what.robot.architecture_of(error.component)
        tries = [t for each in what.tasks.going() for t in what.tasks.tries(each)]
        try:
            for action in (each.action for each in tries if what.robot.folder):
                if blamed.function in action.functions:
                    note_outcome(what.robot, action.name, "failed", [blamed.name])
        except PoiseError as other:
            journal.note("failed", f"that is not learned: {other}")
        raise
