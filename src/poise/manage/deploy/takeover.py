"""Starts a robot, or takes over one that an earlier manager left at work."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from msgspec import structs

from poise.decoding import from_msgpack
from poise.errors import AlreadyManaged, PoiseError, RobotError, RunError, TakenOver
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
    providers,
)
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import (
    ACTIVE_LIMIT,
    READY_LIMIT,
    STOP_LIMIT,
    LiveRobot,
)
from poise.manage.deploy.reconciler import WITNESS_LIMIT, halt
from poise.manage.migration.transition_plan import plan_transition
from poise.manage.migration.transition_run import transit
from poise.manage.shortages.free_room import placed_beside
from poise.model.check.allowed_computers import allowed_computers
from poise.model.robot import Robot
from poise.units import counted
from poise.wire.heartbeats import LEASES_END_WITHIN
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import StepsDone

_LOOK_EVERY = 0.02
_TAKE_OVER = "`poise stop` ends the robot, and `poise up --take-over` takes it over"


def start_or_take_over(
    live: LiveRobot,
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
    try:
        is_at_work = _take_over(
            live, is_rule=is_rule, by_force=by_force, follows=follows
        )
    except Exception:  # no error of a new manager ends a robot that is at work
        live.leave()
        raise
    if not is_at_work:
        live.start_all()


def _take_over(
    live: LiveRobot, *, is_rule: bool, by_force: bool, follows: bool
) -> bool:
    """Go on with a robot that is at work; return whether it is."""
    everyone = {computer.name for computer in live.robot.computers}
    statuses = live.agents.statuses()
    before = [status.manager for status in statuses.values()]
    if live.agents.election is None:
        deployments, unclaimed = _claim(live, by_force=by_force)
    else:
        deployments = _elected(live, follows=follows, by_force=by_force)
        unclaimed = {}
    record = newest_record(deployments.values())
    found = [*found_in(deployments), *_recorded(live, record)]
    reported = found
    if live.agents.election is None:  # no record says what is on computers out of reach
        there = [each for each in found if not record.is_over(*each.key)]
        reported = as_committed(there, live.agents.statuses())
    if record.is_stopped and follows:
        live.end_all("the robot was stopped, and some agents did not know")
        raise RunError("the robot was stopped")
    was_idle = record.generation > 0 and follows
    if not reported and not was_idle:
        if away := everyone - live.claimed:
            names = ", ".join(f"'{name}'" for name in sorted(away - unclaimed.keys()))
            lost = f"nothing runs yet, and no agent answers on {names}: start it there"
            raise RunError("; ".join([*unclaimed.values(), *([lost] if names else [])]))
        if follows:
            raise RunError("nobody has started the robot")
        return False
    said = next((f" of {manager}" for manager in before if manager), "")
    live.journal.note("seen", f"the robot{said} is running: taking it over")
    if by_force or live.agents.election is not None:
        # a person says that nobody else runs anything on the others, or a majority
        # does; not on one that was there, and did not let itself be claimed
        if live.agents.election is None:
            away = everyone - live.claimed - unclaimed.keys()
            unclaimed |= _at_work_elsewhere(live, away)
            gone = away - unclaimed.keys()
            left = tuple(i for i in record.left_behind if i.computer not in gone)
            record = structs.replace(record, left_behind=left)
        live.claimed |= everyone - unclaimed.keys()
    statuses = live.agents.statuses()  # a lease may have ended meanwhile
    fenced = {name for name, status in statuses.items() if status.cut_off}
    held = components_to_hold(live.robot, reported, live.claimed, fenced)
    with _giving_way(live):
        _go_on(live, deployments, unclaimed, reported, held, record, is_rule=is_rule)
    return True


def _go_on(
    live: LiveRobot,
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
    live.has_taken_over = True
    live.goes_on_without_lost = True
    wanted = live.placement()
    if not wanted:  # a standby has no plan of its own
        wanted = record.placement()
    elif record.tasks and not is_rule:
        # the tasks go on where they are, and say themselves what they need
        wanted = _at_work(live, reported, record)
    committed = frozenset[tuple[str, int]]()
    targets = {each.key for each in reported if each.goal == "inactive"}
    is_all = live.claimed >= {computer.name for computer in live.robot.computers}
    if is_half_done(reported, live.robot) or (targets and not is_all):
        committed = _committed(live, reported, deployments, record)
    live.doubted = frozenset(targets - committed)
    adoption = adopt(
        reported,
        live.robot,
        live.layout,
        wanted,
        committed=committed,
        keeps=not is_rule,
    )
    _note(live, adoption)
    allowed = allowed_computers(live.robot)
    starts = {  # what is held counts as placed on a computer that is not claimed
        name: min(allowed[name] - live.claimed) if name in held else computer
        for name, computer in adoption.starts.items()
    }
    kept = {each.key for each in adoption.kept.values()}
    ends = (r.incarnation for r in reported if r.goal == "active" and r.key not in kept)
    other = {n: c for n, c in record.other_code.items() if n not in adoption.restarts}
    last = {r.name: r.spec.epoch for r in sorted(reported, key=lambda r: r.spec.epoch)}
    desired = Desired(
        placed=adoption.kept,
        tasks=record.tasks,
        held=held,
        parameters={**changed_parameters(reported), **record.parameters},
        other_code=other,
        crashed=record.crashed,
        ended={**record.ended, **last},
        left_behind=(*record.left_behind, *ends),
    )
    live.adopt(desired, last)
    for sentence in (*unclaimed.values(), *live.unreached().values()):
        live.journal.note("wrong", sentence)
    seconds = time.monotonic() - began
    live.journal.note("done", "took over", placement=live.placement(), seconds=seconds)
    _start(live, adoption, reported, starts)
    if is_rule:
        _move(live, wanted)


@contextlib.contextmanager
def _giving_way(live: LiveRobot) -> Iterator[None]:
    """End each wait when there is another manager, for agents that obey that one."""
    check = live.check

    def check_both() -> None:
        check()
        _raise_on_successor(live)

    live.check = check_both
    try:
        yield
    finally:
        live.check = check


def _raise_on_successor(live: LiveRobot) -> None:
    if successor := live.agents.successor():
        raise TakenOver(f"{successor} has taken over the robot meanwhile")


def newest_record(deployments: Iterable[Deployment]) -> Desired:
    """Return the record of the last commit that agents stored; else an empty one.

    With a majority of them it is at least that of the last commit that was answered.
    """
    written = [each for each in deployments if each.desired]
    if not written:
        return Desired()
    last = max(written, key=lambda each: (each.term, each.generation))
    return from_msgpack(last.desired, Desired)


def _elected(
    live: LiveRobot, *, follows: bool, by_force: bool
) -> dict[str, Deployment]:
    """Become the leader; return what the agents that voted for it work towards.

    Of that only what is in the newest record counts: all else has surely stopped.
    """
    try:
        answers = live.agents.elect(take_over=by_force)
    except RunError as error:
        hint = "" if follows or by_force else _way_out_of(error)
        raise type(error)(f"{error}{hint}") from None
    live.claimed |= answers.keys()
    away = {computer.name for computer in live.robot.computers} - answers.keys()
    found = {n: answer.deployment for n, answer in answers.items() if answer.deployment}
    record = newest_record(found.values())
    if away and record.incarnations() and _may_hold_leases(live, away):
        names = ", ".join(f"'{name}'" for name in sorted(away))
        raise RunError(f"the leases of components on {names} may not have ended")
    known = {each.key for each in record.incarnations()}
    return {name: _with_only(known, each) for name, each in found.items()}


def _way_out_of(error: RunError) -> str:
    """Return what a person can do whom agents refused, as they obey another manager."""
    return f"; {_TAKE_OVER}" if isinstance(error, AlreadyManaged) else ""


def _may_hold_leases(live: LiveRobot, away: Collection[str]) -> list[str]:
    """Wait until the leases of computers have ended; return those that may have one.

    All must have ended at one moment: one that is heard again may hold a lease again.
    """
    have_ended = live.agents.heartbeats.have_leases_ended
    until = live.clock.now() + LEASES_END_WITHIN
    while left := [name for name in sorted(away) if not have_ended({name})]:
        if live.clock.now() >= until:
            break
        live.clock.sleep(_LOOK_EVERY)
    return left


def _at_work_elsewhere(live: LiveRobot, away: Collection[str]) -> dict[str, str]:
    """Return computers that are out of reach, and that others hear, and why."""
    if not live.agents.is_leased:  # nothing cuts them off
        return {}
    heard_by = live.agents.heartbeats.heard_by
    return {
        name: f"computer '{name}' is out of reach, but "
        f"{repr(other) if (other := heard_by(name)) else 'another one'} hears it: what "
        "may run there starts nowhere else until it is reached"
        for name in _may_hold_leases(live, away)
    }


def _with_only(known: Collection[tuple[str, int]], found: Deployment) -> Deployment:
    """Return a deployment without incarnations that the newest record does not know."""
    containers = (
        structs.replace(
            container,
            components=tuple(c for c in container.components if c.key in known),
        )
        for container in found.containers
    )
    return structs.replace(
        found, containers=tuple(c for c in containers if c.components)
    )


def _recorded(live: LiveRobot, record: Desired) -> list[ReportedIncarnation]:
    """Return what the record places on computers whose agents do not say so."""
    return [
        ReportedIncarnation(
            spec=live.layout.component_spec(
                incarnation, record.parameters.get(incarnation.component, {})
            ),
            computer=incarnation.computer,
            container=live.layout.container_of(incarnation),
            folder=incarnation.code or live.robot.deployed or live.robot.folder,
            code=incarnation.code,
        )
        for incarnation in record.incarnations()
        if incarnation.computer not in live.claimed
    ]


def _at_work(
    live: LiveRobot, reported: Sequence[ReportedIncarnation], record: Desired
) -> dict[str, str]:
    """Return where all is to be that goes on, is new, or that architectures lack.

    What works stays where it is, if it still may. What is lacking may be at work on a
    computer that is out of reach: it counts as there, if it is allowed there, so that
    it is not started twice. Else it goes where there is room. What is only idle ends.
    """
    allowed, wanted = allowed_computers(live.robot), live.placement()
    away = {c.name for c in live.robot.computers} - live.claimed
    works = {e.name: e.computer for e in reported if e.goal != "inactive"}
    ran = {*works, *record.placed, *record.prefetched, *record.ended}
    served = providers(live.robot, works)
    homes: dict[str, tuple[str, ...]] = {}
    for architecture in live.robot.architectures:
        names = [component.name for component in architecture.components]
        is_new = ran.isdisjoint(names) and architecture.function not in served
        stays = architecture.layer != "sequencing" or is_new
        stays = stays and wanted.keys() >= set(names)
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
        robot=live.robot, placement=wanted, solve_steps=live.solve_steps
    )
    first = {name: may[0] for name, may in homes.items()}
    with contextlib.suppress(RobotError):  # what is lacking can run nowhere
        return {**first, **placed_beside(situation, homes).placement}
    return first


def _committed(
    live: LiveRobot,
    reported: Sequence[ReportedIncarnation],
    deployments: Mapping[str, Deployment],
    record: Desired,
) -> frozenset[tuple[str, int]]:
    """Return the targets of half-done migrations that count; none goes on then.

    There may be two: an agent that was cut off may not know of the end of the one
    before. A container that began a step after the commit knows of that. When none did,
    the migration can be rolled back. A target that does not answer may have begun it:
    it is asked again, and ended when it still does not. Unknown is never taken for
    "no": a target on a computer that is gone counts as committed, with all others of
    its migration, if that may have begun.
    """
    asked = {
        (computer, container.name)
        for computer, deployment in deployments.items()
        for container in deployment.containers
    }
    targets = [each for each in reported if each.goal == "inactive"]
    committed = {each.key for each in targets if each.computer not in deployments}
    committed -= _not_begun(live.robot, record, deployments.keys())
    until = live.clock.now() + WITNESS_LIMIT
    while True:
        unknown: dict[tuple[str, str], str] = {}
        numbered = dict(zip(live.batch_numbers, sorted(asked), strict=False))
        halts = [(at, halt(number, name)) for number, (at, name) in numbered.items()]
        for outcome in live.agents.send_steps(halts):
            where = numbered[outcome.number]
            if not isinstance(outcome, StepsDone):
                unknown[where] = outcome.reason
            elif outcome.is_committed or not committed.isdisjoint(outcome.targets):
                committed |= set(outcome.targets)
        _raise_on_successor(live)  # what was found is out of date
        asked = set(unknown)
        doubted = [each for each in targets if each.key not in committed]
        if not asked or not doubted or live.clock.now() >= until:
            break
        _claim_again(live, asked)
        live.clock.sleep(LOOK_EVERY)
    # nothing goes on in the container of a target before the commit
    asked &= {(each.computer, each.container) for each in doubted}
    for where in sorted(asked):
        why = "it is stopped, since it may have gone on with the move"
        what = f"during a migration, {unknown[where]}: {why}"
        live.journal.note("decided", what)
    if asked:
        _end_containers(live, asked, deployments)
    return frozenset(committed & {each.key for each in targets})


def _not_begun(
    robot: Robot, record: Desired, answering: Collection[str]
) -> set[tuple[str, int]]:
    """Return what is idle in the newest record, and of no migration that has begun.

    A migration begins once the agents of all its targets know that it does, so it has
    not while one of those that answer knows of none.
    """
    ahead = {each.component: each for each in record.configured_ahead}
    found = {each.key for each in record.prefetched.values()}
    for architecture in robot.architectures:
        names = {component.name for component in architecture.components}
        targets = [ahead[n] for n in names & ahead.keys() - record.placed.keys()]
        if any(target.computer in answering for target in targets):
            found |= {target.key for target in targets}
    return found


def _claim_again(live: LiveRobot, asked: Iterable[tuple[str, str]]) -> None:
    """Claim agents again that were cut off meanwhile: until then they refuse all.

    Where leaders are elected such an agent obeys the claim of another one, which tries.
    """
    for computer in sorted({computer for computer, _ in asked}):
        if not live.agents.heartbeats.is_cut_off(computer):
            continue
        if live.agents.election is not None:
            raise RunError(f"the lease of '{computer}' has ended amid the take-over")
        with contextlib.suppress(RunError):  # it is asked again
            live.agents.claim({computer})


def _end_containers(
    live: LiveRobot,
    gone: Collection[tuple[str, str]],
    deployments: Mapping[str, Deployment],
) -> None:
    """End containers that do not answer, before others go on in their place."""
    for computer in sorted({computer for computer, _ in gone}):
        before = deployments[computer]
        left = tuple(c for c in before.containers if (computer, c.name) not in gone)
        generation = live.agents.statuses()[computer].generation + 1
        fewer = structs.replace(before, generation=generation, containers=left)
        live.agents.begin_deploy(computer, fewer)

    def still_there() -> list[str]:
        return [
            f"container '{container.name}' on '{computer}'"
            for computer, status in live.agents.statuses().items()
            for container in status.containers
            if (computer, container.name) in gone
        ]

    if not live.agents.wait_news(lambda: not still_there(), STOP_LIMIT):
        names = ", ".join(still_there())
        raise RunError(
            f"{names} still runs {STOP_LIMIT:g} s after the request to stop it"
        )


def _note(live: LiveRobot, adoption: Adoption) -> None:
    for sentence in adoption.half_done:
        live.journal.note("decided", sentence)
    for name, reason in adoption.restarts.items():
        live.journal.note("decided", f"component '{name}' restarts: {reason}")
    for name in adoption.ends:
        live.journal.note(
            "decided", f"stopping component '{name}': the task does not need it"
        )
    what = f"going on with {counted(len(adoption.kept), 'component')}"
    live.journal.note("decided", what, kept=sorted(adoption.kept))


def _start(
    live: LiveRobot,
    adoption: Adoption,
    reported: Sequence[ReportedIncarnation],
    where: Mapping[str, str],
) -> None:
    """Start what does not go on; what cannot start is a deviation from then on."""
    starts = [live.begun(name, computer) for name, computer in where.items()]
    # it counts as there, though nobody said so
    live.doubted |= {each.key for each in starts if each.component in live.desired.held}
    # what is out of reach starts elsewhere, if it may, or once it is reached
    new = [each for each in starts if each.computer in live.claimed]
    if not starts:
        return
    try:
        for old in reported:
            if old.name in adoption.restarts:
                live.wait_ended(old.incarnation)
        inactive = [incarnation.with_goal("inactive") for incarnation in new]
        live.bring(inactive, READY_LIMIT, "start missing components")
        live.bring(new, ACTIVE_LIMIT, "activate missing components")
        if new:
            live.journal.note("done", f"started {counted(len(new), 'component')}")
    except TakenOver:
        raise
    except RunError as error:
        live.journal.note("failed", f"some missing components did not start: {error}")
    live.commit(live.desired.placing(starts), "missing components are placed")


def _claim(
    live: LiveRobot, *, by_force: bool
) -> tuple[dict[str, Deployment], dict[str, str]]:
    """Return what agents work towards, and why others are to be claimed later."""
    deployments: dict[str, Deployment] = {}
    unclaimed: dict[str, str] = {}
    for number, computer in enumerate(sorted(live.computers())):
        try:
            deployments |= live.agents.claim({computer}, take_over=by_force)
        except RunError as error:
            if number == 0 and computer in live.computers():
                # another manager has the robot
                hint = "" if by_force else _way_out_of(error)
                raise type(error)(f"{error}{hint}") from None
            unclaimed[computer] = str(error)
        else:
            live.claimed.add(computer)
    return deployments, unclaimed


def _move(live: LiveRobot, wanted: Mapping[str, str]) -> None:
    """Move what was kept to where the user wants it."""
    try:
        steps = plan_transition(live.robot, live.placement(), wanted)
        if steps:
            transit(live, steps)
    except TakenOver:
        raise
    except PoiseError as error:
        live.journal.note("failed", f"the placement is unchanged: {error}")
