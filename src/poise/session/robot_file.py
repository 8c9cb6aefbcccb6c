"""A robot file: its problems, the robot that it describes, and its architectures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from os import PathLike
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from poise.errors import FileProblem, RobotError
from poise.estimate.code_version import hash_of
from poise.estimate.success_rates import Belief
from poise.model.check.allowed_computers import notes_of
from poise.model.check.ros2_components import with_code as connected
from poise.model.loading import Source, load_source
from poise.model.repository import search
from poise.model.robot import Architecture, Layer, Robot
from poise.model.yaml_tree import Finding
from poise.plan import keep_components, problem_of
from poise.plan.conflict import conflict
from poise.plan.problem.arrays import arrays_of
from poise.runtime.code_check import check_code_isolated
from poise.session import Say, log, nothing
from poise.session.arguments import check_path, check_robot, check_task, check_type
from poise.session.profiling.stored_profiles import profiled
from poise.units import format_seconds


def check(
    file: str | PathLike[str], arguments: Mapping[str, object] | None = None
) -> tuple[FileProblem, ...]:
    """Return what is wrong with a robot file, else with its code, else its profile.

    Parameters
    ----------
    file
        The robot file.
    arguments
        Values for arguments of the file.

    Returns
    -------
    Problems, each with file, line, column and what is wrong there.
    """
    try:
        source = _checked(file, arguments)
    except RobotError as error:
        return error.problems or (FileProblem(str(file), 0, 0, str(error)),)
    try:
        profiled(source.robot)
    except RobotError as error:
        return (source.positions.problem(Finding(("profile",), str(error))),)
    return ()


def load(
    file: str | PathLike[str],
    arguments: Mapping[str, object] | None = None,
    *,
    say: Say = log.info,
    meanwhile: Callable[[], object] = nothing,
) -> Robot:
    """Return the robot in a file, with the demands that its profile gives.

    Parameters
    ----------
    file
        The robot file.
    arguments
        Values for arguments of the file.
    say
        Takes sentences: where demands are from, which are missing or stale, and which
        architectures of the repository do not fit.
    meanwhile
        Called while another process checks the code.

    Raises
    ------
    RobotError
        The file or its code is wrong; `problems` has all that was found.
    UsageError
        The file has no argument of such a name.
    """
    source = _checked(file, arguments, meanwhile)
    for sentence in source.repository.passed_over:
        say(sentence)
    return profiled(source.robot, say)


def load_bare(
    file: str | PathLike[str], arguments: Mapping[str, object] | None = None
) -> Robot:
    """Return the robot in a file, with the demands there only, or RobotError."""
    return _checked(file, arguments).robot


def _checked(
    file: str | PathLike[str],
    arguments: Mapping[str, object] | None,
    meanwhile: Callable[[], object] = nothing,
) -> Source:
    check_path("file", file)
    kind, is_what = Mapping | None, "a mapping of names to values"
    check_type("arguments", arguments, kind, is_what)
    source = load_source(Path(file), arguments)
    found = check_code_isolated(source.robot, meanwhile=meanwhile)
    findings = found.findings or [*check_late_chains(source.robot)]
    if findings:
        problems = sorted(map(source.positions.problem, findings))
        raise RobotError(problems=problems)
    return replace(source, robot=connected(source.robot, found.code))


def check_late_chains(robot: Robot) -> Iterator[Finding]:
    """Yield the chains whose data spends more time on links than their deadline."""
    if not robot.chains:
        return
    problem = problem_of(robot)
    arrays = arrays_of(problem)
    for limit in problem.time_limits:
        part = keep_components(problem, {*limit.components}, arrays=arrays)
        part = replace(part, time_limits=(), architectures=())
        if conflict(part) is not None:
            continue  # it has no place at all: that is said where it is placed
        found = conflict(replace(part, time_limits=(replace(limit, price=0.0),)))
        if found is not None:
            yield Finding(
                ("chains", limit.name, "deadline"),
                f"chain '{limit.name}' cannot meet its deadline of "
                f"{format_seconds(limit.limit)}, wherever its components run: "
                f"{'; '.join(found.limits)}. It could with {found.relaxation}",
            )


def notes(robot: Robot) -> tuple[str, ...]:
    """Return what a person should know of a robot without problems."""
    recording = robot.workload.recording if robot.workload else ""
    if not recording or (path := Path(robot.folder) / recording).exists():
        return notes_of(robot)
    note = (
        f"workload: recording '{recording}' is not there yet ({path.absolute()}): "
        f"`poise profile` needs it, and `poise run --record {recording}` writes it"
    )
    return (*notes_of(robot), note)


def with_code(robot: Robot) -> Robot:
    """Return the robot with what its classes declare, unless its code is wrong."""
    if robot.code or not any(each.implementation for each in robot.components()):
        return robot
    return connected(robot, check_code_isolated(robot).code)


def task_of(robot: Robot, task: str | None) -> str:
    """Return the task, or the robot's first when none is named, or RobotError."""
    check_robot(robot)
    check_task(task)
    if task is not None:
        return task
    if not robot.tasks:
        raise RobotError(
            f"robot '{robot.name}' has no task to run: add to its file, for instance, "
            "`tasks: {work: {actions: [{name: work, functions: [...]}]}}`"
        )
    return robot.tasks[0].name


def _as_html(robot: Robot) -> str:
    from poise.session.diagrams.draw import draw  # noqa: PLC0415, for notebooks only

    return draw(robot).text(".svg")


# Jupyter asks for it; the model, which stands below, draws nothing
Robot._repr_html_ = _as_html  # type: ignore[attr-defined]


class Listed(Struct, frozen=True, kw_only=True, rename={"where": "from"}):
    """An architecture that a robot has, or could have from the repository.

    Parameters
    ----------
    where
        Its file, line and column.
    package
        The installed package that it is in, with its version.
    hash
        Changes when what it runs does.
    unused
        Why the robot passes it over; empty: it does not.
    """

    function: str
    architecture: str
    where: str
    package: str
    layer: Layer
    quality: float
    hash: str
    components: tuple[str, ...]
    unused: str = ""


class Described(Listed, frozen=True, kw_only=True):
    """The same, with how often actions succeeded with it."""

    learned: tuple[Belief, ...]


def listed(file: Path | None) -> list[Listed]:
    """Return the architectures of a robot and its repository, by function."""
    if file is None:
        problems: list[FileProblem] = []
        offers = search((), problems, ()).offers
        if problems:
            raise RobotError(problems=sorted(problems))
        rows = [_row(o.architecture, str(o.node.place), "", ()) for o in offers]
    else:
        source = load_source(file)
        robot, positions = source.robot, source.positions
        rows = [
            _row(a, str(positions.at(("architectures", a.name))), "", robot.folders)
            for a in robot.architectures
        ]
        rows += [
            _row(o.architecture, str(o.node.place), o.unused, robot.folders)
            for o in source.repository.offers
            if o.unused
        ]
    return sorted(rows, key=lambda row: row.function)


def _row(a: Architecture, where: str, unused: str, folders: tuple[str, ...]) -> Listed:
    return Listed(
        function=a.function,
        architecture=a.name,
        where=where,
        package=a.package,
        layer=a.layer,
        quality=a.quality,
        hash=hash_of(a, folders),
        components=tuple(component.name for component in a.components),
        unused=unused,
    )
