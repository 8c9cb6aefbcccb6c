"""How well architectures serve: outcomes of actions, and what is learned from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from random import Random

from msgspec import Struct
from msgspec.structs import replace

from poise.clock import wall_time
from poise.errors import UsageError
from poise.estimate.architecture_hash import hash_of
from poise.estimate.success import Conditions, Ending, Outcome, Posterior, SuccessStore
from poise.model.robot import Architecture, Robot
from poise.model.tasks.steps import Action, actions_of
from poise.suggest import unknown

STORE = Path(".poise") / "success.sqlite"
WELL = Conditions()
"""All computers are there, and the CPU is not short."""


class Belief(Struct, frozen=True, kw_only=True):
    """What is believed of the success of an action with an architecture.

    Parameters
    ----------
    hash
        Of the architecture as it ran.
    is_present
        Whether this is its hash now: only such outcomes count.
    mean, deviation
        Of the success rate.
    low, high
        It is between these with a probability of 90 %.
    """

    action: str
    conditions: Conditions
    hash: str
    is_present: bool
    done: int
    failed: int
    mean: float
    deviation: float
    low: float
    high: float


class Learned(Struct, frozen=True):
    """A robot whose alternatives know their success, and sentences about it."""

    robot: Robot
    says: tuple[str, ...] = ()


def note_outcome(
    robot: Robot,
    action: str,
    ending: Ending,
    architectures: Mapping[str, str] | Iterable[str],
    *,
    conditions: Conditions = WELL,
) -> None:
    """Note how an action ended, so that the next choice of architectures knows.

    Parameters
    ----------
    robot
        As `poise.load` returns it; its folder keeps the outcomes.
    action
        The name of the action.
    ending
        ``done`` or ``failed``.
    architectures
        What served the action: `Placement.architectures`, of which those count whose
        function the action needs; or names of architectures, which all count.
    conditions
        What was known of the circumstances.

    Raises
    ------
    UsageError
        The robot has no such action or architecture, or is from no file; or there is
        no such ending.
    """
    functions = _functions_of(robot, action)
    if ending not in ("done", "failed"):
        raise UsageError(f"ending is {ending!r}: it is 'done' or 'failed'")
    if isinstance(architectures, Mapping):
        architectures = [architectures[f] for f in architectures if f in functions]
    served = [named(robot, name) for name in architectures]
    with _store(robot) as store:
        for each in served:
            outcome = Outcome(
                at=wall_time(),
                action=action,
                conditions=conditions,
                function=each.function,
                architecture=each.name,
                hash=hash_in(robot, each),
                ending=ending,
            )
            store.add(robot.name, outcome)


def learned(
    robot: Robot,
    actions: Iterable[Action],
    *,
    conditions: Conditions = WELL,
    explore: bool = False,
    seed: int = 0,
) -> Learned:
    """Return the robot whose alternatives have the success that was learned.

    That of an architecture is the mean over the actions that need its function. A
    function of which nothing is known stays as it is.
    """
    explore = explore or robot.explore
    rivals = list(_rivals(robot, tuple(actions)))
    if not rivals or not (explore or _has_outcomes(robot)):
        return Learned(robot)
    believed = _posteriors(robot, (a for _, group in rivals for a in group), conditions)
    count = sum(each.count for by in believed.values() for each in by.values())
    success: dict[str, float] = {}
    says = []
    for needing, group in rivals:
        of = {
            a.name: [believed[a.name].get(n, Posterior()) for n in needing]
            for a in group
        }
        if not explore and not any(p.count for each in of.values() for p in each):
            continue
        for name, beliefs in of.items():
            random = Random(f"{seed} {count} {name}")  # noqa: S311 - no secret
            rates = [b.sample(random) if explore else b.mean for b in beliefs]
            success[name] = sum(rates) / len(rates)
        says.append(_sentence(group[0].function, of, success, explore=explore))
    changed = tuple(
        replace(a, success=success.get(a.name, a.success)) for a in robot.architectures
    )
    return Learned(replace(robot, architectures=changed), tuple(says))


def actions_in(robot: Robot, task: str | None) -> Iterator[Action]:
    """Yield the actions of a task, and of the tasks that it names; None: of all."""
    tasks = {each.name: each for each in robot.tasks}
    for name in tasks if task is None else (task,):
        yield from actions_of(tasks, name)


def beliefs_about(robot: Robot, architecture: str) -> list[Belief]:
    """Return what was learned of an architecture, by action, conditions and hash."""
    if not _has_outcomes(robot):
        return []
    now = hash_in(robot, named(robot, architecture))
    with _store(robot) as store:
        found = store.posteriors(robot.name, architecture)
    beliefs = []
    for (action, conditions, hash_), posterior in found.items():
        low, high = posterior.interval()
        beliefs.append(
            Belief(
                action=action,
                conditions=conditions,
                hash=hash_,
                is_present=hash_ == now,
                done=posterior.done,
                failed=posterior.failed,
                mean=posterior.mean,
                deviation=posterior.deviation,
                low=low,
                high=high,
            )
        )
    return beliefs


def forget(robot: Robot, architecture: str) -> int:
    """Forget what was learned of an architecture; return the number of outcomes."""
    named(robot, architecture)
    if not _has_outcomes(robot):
        return 0
    with _store(robot) as store:
        return store.reset(robot.name, architecture)


def hash_in(robot: Robot, architecture: Architecture) -> str:
    """Return the hash of an architecture of the robot."""
    return hash_of(architecture, (robot.folder, *robot.repository))


def named(robot: Robot, name: str) -> Architecture:
    """Return the architecture called `name`; UsageError when there is none."""
    for architecture in robot.architectures:
        if architecture.name == name:
            return architecture
    raise UsageError(
        unknown("architecture", name, [a.name for a in robot.architectures])
    )


def _functions_of(robot: Robot, action: str) -> set[str]:
    actions = list(actions_in(robot, None))
    if all(each.name != action for each in actions):
        raise UsageError(unknown("action", action, [each.name for each in actions]))
    return {f for each in actions if each.name == action for f in each.functions}


def _rivals(
    robot: Robot, actions: tuple[Action, ...]
) -> Iterator[tuple[list[str], list[Architecture]]]:
    """Yield the alternatives for each function, and the actions that need it."""
    groups: dict[str, list[Architecture]] = {}
    for a in robot.architectures:
        if a.layer == "sequencing":
            groups.setdefault(a.function, []).append(a)
    for function, group in groups.items():
        needing = dict.fromkeys(a.name for a in actions if function in a.functions)
        if len(group) > 1 and needing:
            yield list(needing), group


def _posteriors(
    robot: Robot, architectures: Iterable[Architecture], conditions: Conditions
) -> dict[str, dict[str, Posterior]]:
    """Return architecture -> action -> what its outcomes in this conditions say."""
    if not _has_outcomes(robot):
        return {a.name: {} for a in architectures}
    found = {}
    with _store(robot) as store:
        for a in architectures:
            key = conditions, hash_in(robot, a)
            every = store.posteriors(robot.name, a.name).items()
            found[a.name] = {k[0]: each for k, each in every if k[1:] == key}
    return found


def _sentence(
    function: str,
    of: Mapping[str, list[Posterior]],
    success: Mapping[str, float],
    *,
    explore: bool,
) -> str:
    parts = []
    for name, beliefs in of.items():
        mean = sum(b.mean for b in beliefs) / len(beliefs)
        error = sum(b.deviation**2 for b in beliefs) ** 0.5 / len(beliefs)
        drawn = f", drawn {success[name]:.0%}" if explore else ""
        count = sum(b.count for b in beliefs)
        parts.append(f"'{name}' {mean:.0%} ± {error:.0%} of {count}{drawn}")
    return f"success learned for {function}: {'; '.join(parts)}"


def _has_outcomes(robot: Robot) -> bool:
    return bool(robot.folder) and (Path(robot.folder) / STORE).exists()


def _store(robot: Robot) -> SuccessStore:
    if not robot.folder:
        raise UsageError(
            f"robot '{robot.name}' is from no file, so there is no folder to keep "
            "outcomes in: load it with `poise.load`, or set its `folder`"
        )
    return SuccessStore(Path(robot.folder) / STORE)
