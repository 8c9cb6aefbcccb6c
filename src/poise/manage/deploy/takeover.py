"""Starts a robot, or takes over one that an earlier manager left at work."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from msgspec import structs

from poise.decoding import from_msgpack
from poise.errors import PoiseError, RobotError, RunError
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.reports import LOOK_EVERY
from poise.manage.deploy.adoption import (
    Adoption,
    ReportedIncarnation,
    adopt,
    as_committed,
    changed_parameters,
    components_to_hold,
    found_in,
    is_half_done,
    where_held,
)
from poise.manage.deploy.desired import Desired, Incarnation
from poise.manage.deploy.reconciler import WITNESS_LIMIT, halt
from poise.manage.deploy.running_components import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    STOP_LIMIT,
    RunningComponents,
)
from poise.manage.migration.transition_plan import plan_transition
from poise.manage.migration.transition_run import transit
from poise.manage.shortages.free_room import placed_beside
from poise.model.check.allowed_computers import allowed_computers
from poise.units import counted
from poise.wire.heartbeats import LEASES_END_WITHIN
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import StepsDone, StepsOutcome

_LOOK_EVERY = 0.02
_TAKE_OVER = "`poise stop` ends the robot, and `poise up --take-over` takes it over"


def start_or_take_over(
    run: RunningComponents,
    *,
    is_rule: bool = False,
    by_force: bool = False,
    follows: bool = False,
) -> None:
    """Bring a robot up: what runs as it should goes on, and the rest is started.

    `is_rule`: whether the user asked for the placement; else what runs stays where it
    is. `follows`: a standby has no plan of its own, and goes on with the robot as it
    was.
    """
    statuses = run.agents.statuses()
    before = [status.manager for status in statuses.values()]
    if run.agents.election is None:
        deployments, unclaimed = _claim(run, by_force=by_force)
    else:
        hint = "" if follows else f"; {_TAKE_OVER}"
        deployments, unclaimed = _elected(run, hint, by_force=by_force), {}
    record = newest_record(deployments.values())
    found = [*found_in(deployments), *_recorded(run, record)]
    reported = found
    if run.agents.election is None:  # no record says what is on computers out of reach
        reported = as_committed(found, run.agents.statuses())
    if record.is_stopped and follows:
        run.end_all("the robot was stopped, and some agents did not know")
        run.leave()
        raise RunError("the robot was stopped")
    was_idle = record.generation > 0 and follows
    if not reported and not was_idle:
        away = {computer.name for computer in run.robot.computers} - run.claimed
        if away:
            run.leave()  # their components may be another manager's
            names = ", ".join(f"'{name}'" for name in sorted(away - unclaimed.keys()))
            lost = f"nothing runs yet, and no agent answers on {names}: start it there"
            raise RunError("; ".join([*unclaimed.values(), *([lost] if names else [])]))
        if follows:
            run.leave()
            raise RunError("nobody has started the robot")
        run.start_all()
        return
    said = next((f" of {manager}" for manager in before if manager), "")
    run.journal.note("seen", f"the robot{said} is running: taking it over")
    if by_force or run.agents.election is not None:
        # a person says that nobody else runs anything on the others, or a majority
        # does; not on one that was there, and did not let itself be claimed
        everyone = {computer.name for computer in run.robot.computers}
        run.claimed |= everyone - unclaimed.keys()
    statuses = run.agents.statuses()  # a lease may have ended meanwhile
    fenced = {name for name, status in statuses.items() if status.cut_off}
    held = components_to_hold(run.robot, reported, run.claimed, fenced)
    try:
        _take_over(run, deployments, unclaimed, reported, held, record, is_rule=is_rule)
    except Exception:
        run.leave()  # no error of a new manager ends a robot that is at work
        raise


def _take_over(
    run: RunningComponents,
    deployments: Mapping[str, Deployment],
    unclaimed: Mapping[str, str],
    reported: Sequence[ReportedIncarnation],
    held: frozenset[str],
    record: Desired,
    *,
    is_rule: bool,
) -> None:
    began = time.monotonic()
    # what comes back from now on is claimed and told then
    run.has_taken_over = True
    run.goes_on_without_lost = True
    wanted = run.placement()
    if not wanted:  # a standby has no plan of its own
        wanted = record.placement()
    elif record.tasks and not is_rule:
        # the tasks go on where they are, and say themselves what they need
        wanted = _at_work(run, reported)
    committed = frozenset[tuple[str, int]]()
    targets = {each.key for each in reported if each.goal == "inactive"}
    is_all = run.claimed >= {computer.name for computer in run.robot.computers}
    if is_half_done(reported, run.robot) or (targets and not is_all):
        committed = _committed(run, reported, deployments)
    run.doubted = targets - committed
    adoption = adopt(
        reported,
        run.robot,
        run.layout,
        wanted,
        committed=committed,
        keeps=not is_rule,
    )
    _note(run, adoption)
    starts = where_held(run.robot, adoption.starts, held, run.claimed)
    run.adopt(
        adoption.kept,
        _last_epochs(reported),
        record.tasks,
        held,
        changed_parameters(reported),
    )
    for sentence in (*unclaimed.values(), *run.unreached().values()):
        run.journal.note("wrong", sentence)
    seconds = time.monotonic() - began
    run.journal.note("done", "took over", placement=run.placement(), seconds=seconds)
    _start(run, adoption, reported, starts)
    if is_rule:
        _move(run, wanted)


def newest_record(deployments: Iterable[Deployment]) -> Desired:
    """Return the record of the last commit that agents have stored; else an empty one.

    With a majority of them it is at least that of the last commit that was answered.
    """
    written = [each for each in deployments if each.desired]
    if not written:
        return Desired()
    last = max(written, key=lambda each: (each.term, each.generation))
    return from_msgpack(last.desired, Desired)


def _elected(
    run: RunningComponents, hint: str, *, by_force: bool
) -> dict[str, Deployment]:
    """Become the leader; return what the agents that voted for it work towards.

    What others run has surely stopped then. Of what agents work towards, only that
    counts which is in the newest record.
    """
    try:
        answers = run.agents.elect(take_over=by_force)
    except RunError as error:
        run.leave()
        raise RunError(f"{error}{hint}") from None
    run.claimed |= answers.keys()
    away = {computer.name for computer in run.robot.computers} - answers.keys()
    found = {n: answer.deployment for n, answer in answers.items() if answer.deployment}
    record = newest_record(found.values())
    if away and record.incarnations():
        until = run.clock.now() + LEASES_END_WITHIN
        while not run.agents.heartbeats.have_leases_ended(away):
            if run.clock.now() >= until:
                run.leave()
                names = ", ".join(f"'{name}'" for name in sorted(away))
                raise RunError(
                    f"the leases of components on {names} may not have ended"
                )
            run.clock.sleep(_LOOK_EVERY)
    known = {each.key for each in record.incarnations()}
    return {name: _with_only(known, each) for name, each in found.items()}


def _with_only(known: Collection[tuple[str, int]], found: Deployment) -> Deployment:
    """Return a deployment without incarnations that the newest record does not know."""
    containers = (
        structs.replace(
            container,
            components=tuple(
                c for c in container.components if (c.name, c.epoch) in known
            ),
        )
        for container in found.containers
    )
    return structs.replace(
        found, containers=tuple(c for c in containers if c.components)
    )


def _recorded(run: RunningComponents, record: Desired) -> list[ReportedIncarnation]:
    """Return what the record places on computers whose agents do not say so."""
    return [
        ReportedIncarnation(
            spec=run.layout.component_spec(
                incarnation, record.parameters.get(incarnation.component, {})
            ),
            computer=incarnation.computer,
            container=run.layout.container_of(incarnation),
            folder=incarnation.code or run.robot.deployed or run.robot.folder,
            code=incarnation.code,
        )
        for incarnation in record.incarnations()
        if incarnation.computer not in run.claimed
    ]


def _at_work(
    run: RunningComponents, reported: Sequence[ReportedIncarnation]
) -> dict[str, str]:
    """Return what works, with what its architectures lack, and layers that never stop.

    What works stays where it is, if it still may. What is lacking may be at work on a
    computer that is out of reach: it counts as there, if it is allowed there, so that
    it is not started twice. Else it goes where there is room. What is only idle ends.
    """
    allowed, wanted = allowed_computers(run.robot), run.placement()
    away = {c.name for c in run.robot.computers} - run.claimed
    works = {e.name: e.computer for e in reported if e.goal != "inactive"}
    homes: dict[str, tuple[str, ...]] = {}
    for architecture in run.robot.architectures:
        names = [component.name for component in architecture.components]
        stays = architecture.layer != "sequencing" and wanted.keys() >= set(names)
        if not stays and works.keys().isdisjoint(names):
            continue
        for name in names:
            may = allowed[name] & away or allowed[name]
            if works.get(name) in allowed[name]:
                homes[name] = (works[name],)
            elif wanted.get(name) in may:
                homes[name] = (wanted[name],)
            else:
                homes[name] = tuple(sorted(may))
    situation = Situation(
        robot=run.robot, task="", placement=wanted, solve_steps=run.solve_steps
    )
    with contextlib.suppress(RobotError):  # what is lacking can run nowhere
        return {
            **{name: may[0] for name, may in homes.items()},
            **placed_beside(situation, homes).placement,
        }
    return {name: may[0] for name, may in homes.items()}


def _committed(
    run: RunningComponents,
    reported: Sequence[ReportedIncarnation],
    deployments: Mapping[str, Deployment],
) -> frozenset[tuple[str, int]]:
    """Return the targets of half-done migrations that count; none goes on then.

    There may be two: an agent that was cut off may not know of the end of the one
    before. A container that began a step after the commit knows of that. When none did,
    the migration can be rolled back. A target that does not answer may have begun it:
    it is asked again, and ended when it still does not. Unknown is never taken for
    "no": a target on a computer that is gone counts as committed, with all others of
    its migration.
    """
    asked = {
        (computer, container.name)
        for computer, deployment in deployments.items()
        for container in deployment.containers
    }
    targets = [each for each in reported if each.goal == "inactive"]
    committed = {each.key for each in targets if each.computer not in deployments}
    until = run.clock.now() + WITNESS_LIMIT
    while True:
        unknown: dict[tuple[str, str], str] = {}
        for where, outcome in _halted(run, asked):
            if not isinstance(outcome, StepsDone):
                unknown[where] = outcome.reason
            elif outcome.is_committed or not committed.isdisjoint(outcome.targets):
                committed |= set(outcome.targets)
        if successor := run.agents.successor():  # what was found is out of date
            raise RunError(f"{successor} has taken over the robot meanwhile")
        asked = set(unknown)
        doubted = [each for each in targets if each.key not in committed]
        if not asked or not doubted or run.clock.now() >= until:
            break
        _raise_on_ended_leases(run, asked)
        run.clock.sleep(LOOK_EVERY)
    # nothing goes on in the container of a target before the commit
    asked &= {(each.computer, each.container) for each in doubted}
    for where in sorted(asked):
        why = (
            f"{unknown[where]}: it is stopped, since it may have gone on with the move"
        )
        run.journal.note("decided", f"during a migration, {why}")
    if asked:
        _end_containers(run, asked, deployments)
    return frozenset(committed & {each.key for each in targets})


def _raise_on_ended_leases(
    run: RunningComponents, asked: Iterable[tuple[str, str]]
) -> None:
    """Let another leader try, whose claim an agent obeys that was cut off amid it."""
    if run.agents.election is None:
        return
    for computer in sorted({computer for computer, _ in asked}):
        if run.agents.heartbeats.is_cut_off(computer):
            raise RunError(f"the lease of '{computer}' has ended amid the take-over")


def _halted(
    run: RunningComponents, containers: Collection[tuple[str, str]]
) -> Iterator[tuple[tuple[str, str], StepsOutcome]]:
    """Let containers go on with nothing of a migration; yield what each answers."""
    by_number = dict(zip(run.batch_numbers, sorted(containers), strict=False))
    batches = [
        (computer, halt(number, container))
        for number, (computer, container) in by_number.items()
    ]
    for outcome in run.agents.send_steps(batches):
        yield by_number[outcome.number], outcome


def _end_containers(
    run: RunningComponents,
    gone: Collection[tuple[str, str]],
    deployments: Mapping[str, Deployment],
) -> None:
    """End containers that do not answer, before others go on in their place."""
    for computer in sorted({computer for computer, _ in gone}):
        before = deployments[computer]
        left = tuple(c for c in before.containers if (computer, c.name) not in gone)
        generation = run.agents.statuses()[computer].generation + 1
        fewer = structs.replace(before, generation=generation, containers=left)
        run.agents.begin_deploy(computer, fewer)

    def still_there() -> list[str]:
        return [
            f"container '{container.name}' on '{computer}'"
            for computer, status in run.agents.statuses().items()
            for container in status.containers
            if (computer, container.name) in gone
        ]

    if not run.agents.wait_news(lambda: not still_there(), STOP_LIMIT):
        names = ", ".join(still_there())
        raise RunError(
            f"{names} still runs {STOP_LIMIT:g} s after the request to stop it"
        )


def _last_epochs(found: Sequence[ReportedIncarnation]) -> dict[str, int]:
    epochs: dict[str, int] = {}
    for reported in found:
        epochs[reported.name] = max(reported.spec.epoch, epochs.get(reported.name, 0))
    return epochs


def _note(run: RunningComponents, adoption: Adoption) -> None:
    for sentence in adoption.half_done:
        run.journal.note("decided", sentence)
    for name, reason in adoption.restarts.items():
        run.journal.note("decided", f"component '{name}' restarts: {reason}")
    for name in adoption.ends:
        run.journal.note(
            "decided", f"stopping component '{name}': the task does not need it"
        )
    what = f"going on with {counted(len(adoption.kept), 'component')}"
    run.journal.note("decided", what, kept=sorted(adoption.kept))


def _start(
    run: RunningComponents,
    adoption: Adoption,
    reported: Sequence[ReportedIncarnation],
    where: Mapping[str, str],
) -> None:
    """Start what does not go on; what cannot start is a deviation from then on."""
    starts = [
        Incarnation(component=name, computer=computer, epoch=run.next_epoch(name))
        for name, computer in where.items()
    ]
    # what is out of reach starts elsewhere, if it may, or once it is reached
    new = [incarnation for incarnation in starts if incarnation.computer in run.claimed]
    if not starts:
        return
    try:
        for old in reported:
            if old.name in adoption.restarts:
                run.wait_ended(old.incarnation)
        inactive = [incarnation.with_goal("inactive") for incarnation in new]
        run.bring(inactive, READY_LIMIT, "start missing components")
        run.bring(new, ACTIVE_LIMIT, "activate missing components")
        if new:
            run.journal.note("done", f"started {counted(len(new), 'component')}")
    except RunError as error:
        run.journal.note("failed", f"some missing components did not start: {error}")
    run.commit(run.desired.placing(starts), "missing components are placed")


def _claim(
    run: RunningComponents, *, by_force: bool
) -> tuple[dict[str, Deployment], dict[str, str]]:
    """Return what the agents work towards, and why some were not claimed.

    Those are claimed once they answer.
    """
    deployments: dict[str, Deployment] = {}
    unclaimed: dict[str, str] = {}
    computers = sorted(run.computers())
    for computer in computers:
        try:
            deployments |= run.agents.claim({computer}, take_over=by_force)
        except RunError as error:
            unclaimed[computer] = str(error)
            if computer == computers[0] and computer in run.computers():
                break  # another manager has the robot
        else:
            run.claimed.add(computer)
    if computers and computers[0] in unclaimed and not deployments:
        run.leave()
        raise RunError(f"{unclaimed[computers[0]]}; {_TAKE_OVER}")
    return deployments, unclaimed


def _move(run: RunningComponents, wanted: Mapping[str, str]) -> None:
    """Move what was kept to where the user wants it."""
    try:
        steps = plan_transition(run.robot, run.placement(), wanted)
        if steps:
            transit(run, steps)
    except PoiseError as error:
        run.journal.note("failed", f"the placement is unchanged: {error}")
