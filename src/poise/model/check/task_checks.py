"""Tasks: known names, no task within itself, ends that fit, and nothing used twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping

from poise.errors import did_you_mean, listed, unknown
from poise.model.check.connectors import KnownPort, Ports, no_such_port
from poise.model.check.names import component_names
from poise.model.condition import check_sentence, parse_condition
from poise.model.phases import MOST_PHASES, TooManyPhasesError, clashes, phases_of
from poise.model.policy import ACTIONS, SUBJECTS, Policy, Subject, policies_of, shipped
from poise.model.repository import Repository
from poise.model.robot import ConnectorEnd, Robot
from poise.model.steps import Action, Repeat, Subtask, Task, Until, walk
from poise.model.yaml_tree import Finding, Path


def check_policies(robot: Robot, broken: Collection[str]) -> Iterator[Finding]:
    """Yield what is wrong with policies; `broken` ones lack a value that is written."""
    written = {policy.name for policy in robot.policies}
    for policy in policies_of(robot.policies):
        if policy.name not in written:
            continue
        for key, text in _wrong(robot, policy, is_broken=policy.name in broken):
            path = ("policies", policy.name, *([key] if key else []))
            yield Finding(path, f"policy '{policy.name}': {text}")


def _wrong(
    robot: Robot, policy: Policy, *, is_broken: bool
) -> Iterator[tuple[str, str]]:
    """Yield a key of a policy, if it is about one, and what is wrong there."""
    keys = {"for each": policy.for_each, "when": policy.when, "do": policy.do}
    if policy.off:
        known = [policy.name for policy in shipped()]
        if policy.name not in known:
            likely = did_you_mean(policy.name, known)
            what = f"Poise ships no policy '{policy.name}'{likely}"
            yield "", f"{what}; policies: {listed(known)}"
    elif policy.call:
        for key, value in {**keys, "to": policy.to, "by": policy.by}.items():
            if value is not None:
                text = f"a policy with `call` has no '{key}': its function decides"
                yield key, text
    else:
        missing = [key for key, value in keys.items() if value is None]
        if missing and not is_broken:
            yield "", f"a policy of your own needs {listed(missing)}"
        yield from _wrong_texts(robot, policy)
        yield from _wrong_action(robot, policy, is_broken=is_broken)


def _wrong_texts(robot: Robot, policy: Policy) -> Iterator[tuple[str, str]]:
    if policy.for_each is None or policy.when is None:
        return
    record = SUBJECTS[policy.for_each]
    try:
        parse_condition(policy.when, record, choices_of(robot, policy.for_each))
    except ValueError as error:
        yield "when", str(error)
    try:
        check_sentence(policy.say or "", record)
    except ValueError as error:
        yield "say", str(error)


def _wrong_action(
    robot: Robot, policy: Policy, *, is_broken: bool
) -> Iterator[tuple[str, str]]:
    do, subject = policy.do, policy.for_each
    if do is None or subject is None or policy.when is None:
        return
    if subject not in ACTIONS[do]:
        yield (
            "do",
            f"'{do}' is done for each {listed(ACTIONS[do])}, not for each '{subject}'",
        )
    if do == "move" and policy.to is None and not is_broken:
        yield "do", "'move' needs 'to', a computer"
    for key, wanted in (("to", "move"), ("by", "replace")):
        if getattr(policy, key) is not None and do != wanted:
            yield key, f"'{key}' is for '{wanted}', not '{do}'"
    of = Counter(architecture.function for architecture in robot.architectures)
    if do == "replace" and policy.by is None and max(of.values(), default=0) <= 1:
        yield "do", "no function has two architectures, so nothing can be replaced"
    for a in robot.architectures:
        if do == "replace" and a.name == policy.by and of[a.function] == 1:
            text = f"'{a.name}' alone provides '{a.function}', so it can replace none"
            yield "by", text


def choices_of(robot: Robot, subject: Subject) -> Mapping[str, tuple[str, ...]]:
    """Return the names that values of a subject may have."""
    computers = tuple(computer.name for computer in robot.computers)
    names = {
        "computer": computers,
        "component": tuple(component_names(robot)),
        "link": tuple("-".join(link.between) for link in robot.links),
        "chain": tuple(chain.name for chain in robot.chains),
    }
    return {
        "computer": computers,
        "component": names["component"],
        "architecture": tuple(a.name for a in robot.architectures),
        "name": names.get(subject, ()),
    }


def check_tasks(robot: Robot, repository: Repository) -> Iterator[Finding]:
    """Yield what is wrong with the tasks of a robot."""
    findings = [
        finding for task in robot.tasks for finding in _names(robot, task, repository)
    ]
    yield from findings
    for task in robot.tasks:
        yield from _needs(robot, task)
    for task in robot.tasks:
        for path, until in _conditions(task):
            yield from _condition(robot, path, until)
    if not findings:  # phases need names that exist, and no cycles
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


def check_timers(
    robot: Robot, timers: Mapping[str, Collection[str]]
) -> Iterator[Finding]:
    """Yield conditions about timers that components do not have, as far as known."""
    for task in robot.tasks:
        for path, until in _conditions(task):
            component, _, timer = until.name.partition(".")
            known = timers.get(component) if until.subject == "timer" else None
            if known is not None and timer not in known:
                text = unknown("timer", timer, known)
                yield Finding((*path, "timer"), f"component '{component}': {text}")


_ENDS = {("publishes", "bool"), ("publishes", "builtins:bool")}


def _names(robot: Robot, task: Task, repository: Repository) -> Iterator[Finding]:
    tasks = [task.name for task in robot.tasks]
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
    """Yield the functions that no architecture provides, or that are listed twice."""
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
    names = component_names(robot)
    if end.component not in names:
        yield Finding(path, unknown("component", end.component, names))
        return
    if not end.port:
        text = f"name the port of '{end.component}' too, as in {end.component}.done"
        yield Finding(path, text)
    own = robot.architecture_of(end.component)
    if own.function not in action.functions:
        yield Finding(
            path,
            f"component '{end.component}' belongs to the function '{own.function}', "
            f"which action '{action.name}' does not need: add it to `functions`",
        )
    others = [a.name for a in robot.architectures if a.function == own.function]
    others.remove(own.name)
    if others and own.layer == "sequencing":
        yield Finding(
            path,
            f"component '{end.component}' belongs to architecture '{own.name}', but "
            f"{listed(others)} may provide '{own.function}' without it, and nothing "
            f"would end the action: let a component of another function publish "
            "its end, or use `until`",
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
    kind, name, names = until.subject, until.name, choices["name"]
    timer = "?"
    if kind == "timer":  # `check_timers` knows which ones a component has
        kind, names = "component", choices["component"]
        name, _, timer = name.partition(".")
    if kind not in ("robot", "container") and name not in names:
        yield Finding((*path, until.subject), unknown(kind, name, names))
    elif not timer:
        text = f"name the timer of '{name}' too, as in {name}.update"
        yield Finding((*path, "timer"), text)
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
            f"task '{task.name}' has more than {MOST_PHASES} phases: sets "
            "of actions at the same time, in all combinations of parallel steps. Make "
            "it several tasks",
        )
        return
    reported: set[str] = set()
    for phase in phases:
        for clash in clashes(robot, phase.actions):
            if str(clash) not in reported:
                reported.add(str(clash))
                yield Finding(_of(task, phase.actions), str(clash))


def _of(task: Task, actions: tuple[Action, ...]) -> Path:
    """Return the path of the last of these actions that is in the task itself."""
    paths = [path for path, step in walk(task) if step in actions]
    return ("tasks", task.name, *(paths[-1] if paths else ()))


def check_workload(robot: Robot) -> Iterator[Finding]:
    """Yield an empty workload, and what is generated for no port."""
    workload = robot.workload
    if workload is None:
        return
    if not (workload.command or workload.recording or workload.generate):
        yield Finding(
            ("workload",), "the workload is empty: give command, recording or generate"
        )
    names = component_names(robot)
    for generated in workload.generate:
        end = generated.port
        if not end.port and end.component in names:
            path = ("workload", "generate", str(end))
            yield Finding(path, f"give the port, as in {end.component}.scan")


def check_generated(
    robot: Robot, known: Mapping[str, Mapping[str, KnownPort]]
) -> Iterator[Finding]:
    """Yield generated messages for ports that do not subscribe."""
    for generated in robot.workload.generate if robot.workload else ():
        ports = known.get(generated.port.component)
        if ports is None:
            continue  # its code is faulty, which is reported already
        subscribing = [
            name for name, port in ports.items() if port.kind == "subscribes"
        ]
        if generated.port.port not in subscribing:
            yield Finding(
                ("workload", "generate", str(generated.port)),
                f"'{generated.port.component}' subscribes to no "
                f"'{generated.port.port}'; it subscribes to {listed(subscribing)}",
            )
