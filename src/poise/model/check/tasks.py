"""Tasks: known names, no task within itself, ends that fit, and nothing used twice."""

from __future__ import annotations

from collections.abc import Iterator

from poise.model.check.file_paths import component_names
from poise.model.check.policies import choices_of
from poise.model.check.ports import Ports, no_such_port
from poise.model.policy.condition import parse_condition
from poise.model.policy.values import SUBJECTS
from poise.model.repository import Repository
from poise.model.robot import ConnectorEnd, Robot
from poise.model.tasks.exclusive import clashes
from poise.model.tasks.phases import MOST_PHASES, TooManyPhasesError, phases_of
from poise.model.tasks.steps import Action, Repeat, Subtask, Task, Until, walk
from poise.model.yaml.positions import Finding, Path
from poise.suggest import did_you_mean, listed, unknown


def check_tasks(robot: Robot, repository: Repository) -> Iterator[Finding]:
    """Yield what is wrong with the tasks of a robot.

    Parameters
    ----------
    repository
        Where functions were looked for that the robot file does not provide.
    """
    found = [
        finding for task in robot.tasks for finding in _names(robot, task, repository)
    ]
    yield from found
    for task in robot.tasks:
        yield from _needs(robot, task)
    for task in robot.tasks:
        for path, until in _conditions(task):
            yield from _condition(robot, path, until)
    if not found:  # phases need names that exist, and no cycles
        for task in robot.tasks:
            yield from _phases(robot, task)


def check_ends(robot: Robot, ports: Ports) -> Iterator[Finding]:
    """Yield the ends that are no published bool, as far as ports are known."""
    for task in robot.tasks:
        for path, step in walk(task):
            if not isinstance(step, Action) or step.ends is None:
                continue
            known = ports.get(step.ends.component)
            if known is None or not step.ends.port:
                continue
            port = known.get(step.ends.port)
            where: Path = ("tasks", task.name, *path, "ends")
            if port is None:
                yield Finding(where, no_such_port(step.ends, known))
            elif (port.kind, port.type) not in _ENDS:
                yield Finding(
                    where,
                    f"'{step.ends}' {port}; what ends an action publishes bool: true "
                    "for done, false for failed",
                )


_ENDS = {("publishes", "bool"), ("publishes", "builtins:bool")}


def _names(robot: Robot, task: Task, repository: Repository) -> Iterator[Finding]:
    tasks = [each.name for each in robot.tasks]
    seen: set[str] = set()
    for path, step in walk(task):
        where: Path = ("tasks", task.name, *path)
        if isinstance(step, Action):
            if step.name in seen:
                text = f"there is an action '{step.name}' in this task already"
                yield Finding((*where, "name"), text)
            seen.add(step.name)
            yield from _functions(robot, (*where, "functions"), step, repository)
            if step.ends is not None:
                yield from _end(robot, (*where, "ends"), step, step.ends)
        elif isinstance(step, Subtask):
            if step.task not in tasks:
                yield Finding((*where, "task"), unknown("task", step.task, tasks))
            elif way := _way_back(robot, task.name, step.task):
                text = f"a task cannot be a step of itself: {' -> '.join(way)}"
                yield Finding((*where, "task"), text)


def _functions(
    robot: Robot, path: Path, action: Action, repository: Repository
) -> Iterator[Finding]:
    """Yield the functions that nobody provides, or that are listed twice."""
    provided = dict.fromkeys(a.function for a in robot.architectures)
    for index, name in enumerate(action.functions):
        if name not in provided:
            text = unknown("function", name, [*provided, *repository.functions])
            yield Finding((*path, index), text + repository.searched)
        elif name in action.functions[:index]:
            yield Finding((*path, index), f"the function '{name}' is listed twice")


def _needs(robot: Robot, task: Task) -> Iterator[Finding]:
    """Yield the needed functions that no action uses."""
    used = robot.functions_of(task.name)
    for index, name in enumerate(task.needs):
        if name not in used:
            text = (
                f"task '{task.name}' uses no function '{name}'"
                f"{did_you_mean(name, used)}; it uses {listed(used)}"
            )
            yield Finding(("tasks", task.name, "needs", index), text)


def _end(
    robot: Robot, path: Path, action: Action, end: ConnectorEnd
) -> Iterator[Finding]:
    """Yield an end that is no port of a component that runs for the action."""
    if end.component not in component_names(robot):
        text = unknown("component", end.component, component_names(robot))
        yield Finding(path, text)
        return
    if not end.port:
        text = f"name the port of '{end.component}' too, as in {end.component}.done"
        yield Finding(path, text)
    function = robot.architecture_of(end.component).function
    if function not in action.functions:
        yield Finding(
            path,
            f"component '{end.component}' belongs to the function '{function}', which "
            f"action '{action.name}' does not need: add it to `functions`",
        )


def _way_back(robot: Robot, home: str, start: str) -> list[str]:
    """Return how a task leads to itself by way of another; empty: it does not."""
    steps = {
        task.name: [s.task for _, s in walk(task) if isinstance(s, Subtask)]
        for task in robot.tasks
    }
    ways = [[home, start]]
    reached = {start}
    for way in ways:  # grows meanwhile
        if way[-1] == home:
            return way
        for after in steps.get(way[-1], ()):
            if after not in reached:
                reached.add(after)
                ways.append([*way, after])
    return []


def _conditions(task: Task) -> Iterator[tuple[Path, Until]]:
    for path, step in walk(task):
        if isinstance(step, Action | Repeat) and step.until is not None:
            yield ("tasks", task.name, *path, "until"), step.until


def _condition(robot: Robot, path: Path, until: Until) -> Iterator[Finding]:
    choices = choices_of(robot, until.subject)
    names = choices["name"]
    if until.name and names and until.name not in names:
        yield Finding((*path, until.subject), unknown(until.subject, until.name, names))
    try:
        parse_condition(until.when, SUBJECTS[until.subject], choices)
    except ValueError as error:
        yield Finding((*path, "when"), str(error))


def _phases(robot: Robot, task: Task) -> Iterator[Finding]:
    try:
        phases = phases_of(robot, task.name)
    except TooManyPhasesError:
        yield Finding(
            ("tasks", task.name),
            f"task '{task.name}' has more than {MOST_PHASES} phases: what runs at the "
            "same time, in all combinations of parallel steps. Make it several tasks",
        )
        return
    told: set[str] = set()
    for phase in phases:
        for clash in clashes(robot, phase.actions):
            if str(clash) not in told:
                told.add(str(clash))
                yield Finding(_of(task, phase.actions), str(clash))


def _of(task: Task, actions: tuple[Action, ...]) -> Path:
    """Return the path of the last of these actions that is in the task itself."""
    paths = [path for path, step in walk(task) if step in actions]
    return ("tasks", task.name, *(paths[-1] if paths else ()))
