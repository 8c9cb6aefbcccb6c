"""A manager starts a robot, or goes on with what an earlier one left."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec import structs
from msgspec.msgpack import encode

from poise.errors import AlreadyManaged, RunError, TakenOver, UsageError
from poise.estimate.code_version import version_of
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.manage.deploy.desired import Desired, Incarnation
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.deploy.takeover import newest_record, start_or_take_over
from poise.manage.journal import Journal
from poise.manage.manager import Manager
from poise.manage.migration.move import plan_replacement
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording
from poise.manage.tasks.task_progress import Saved
from poise.model.robot import Architecture, ComponentEntry, Computer, Robot
from poise.testing import VirtualClock
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import (
    MigrationSteps,
    StepsDone,
    StepsFailed,
    StepsOutcome,
)
from poise.wire.records.request_records import ManagerId
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}
LEFT = (
    Incarnation(component="grabber", computer="left"),
    Incarnation(component="thinker", computer="left", epoch=4),
)
LATER = ManagerId(key="l", user="bob", host="desk", pid=8, since=0.0)


def run_of(robot: Robot, *left: Incarnation) -> tuple[LiveRobot, FakeAgents, Journal]:
    """Return a run whose agents do what an earlier manager told them."""
    agents, journal = FakeAgents("left", "right"), Journal(":memory:")
    gateways = {"left": "left:7000", "right": "right:7000"}
    if left:
        layout = DeploymentLayout(robot, "/run", code_version=version_of)
        for computer, told in layout.deployments(
            Desired(coming=left, generation=5), gateways
        ).items():
            agents.begin_deploy(computer, told)
    live = LiveRobot(robot, PLACEMENT, cast("Agents", agents), journal, "/run")
    return live, agents, journal


def sentences(journal: Journal) -> list[str]:
    return [entry.what for entry in journal.entries()]


def test_starts_everything_where_nothing_runs(robot: Robot) -> None:
    run, agents, journal = run_of(robot)
    start_or_take_over(run, by_force=False)
    assert run.placement() == PLACEMENT
    assert not agents.is_forced
    assert sentences(journal)[-1] == "all components run"


def test_goes_on_with_what_runs_and_says_so(robot: Robot) -> None:
    run, agents, journal = run_of(robot, *LEFT)
    start_or_take_over(run, by_force=True)
    assert run.placement() == {"grabber": "left", "thinker": "left"}
    assert agents.is_forced
    assert sentences(journal)[-1] == "took over"
    containers = [each for _, told in agents.deployed for each in told.containers]
    assert {c.goal for each in containers for c in each.components} == {"active"}


def test_what_runs_just_as_planned_is_told_with_a_later_generation(
    robot: Robot,
) -> None:
    as_planned = (LEFT[0], Incarnation(component="thinker", computer="right"))
    run, agents, _ = run_of(robot, *as_planned)
    start_or_take_over(run, by_force=False)
    assert [told.generation for _, told in agents.deployed[2:]] == [6, 6]


def test_new_incarnations_differ_from_any_that_another_computer_may_run(
    robot: Robot,
) -> None:
    run, *_ = run_of(robot, LEFT[0])
    start_or_take_over(run, by_force=False)
    assert run.placement() == PLACEMENT
    assert run.placed["thinker"].epoch > 5  # as high as the generation, at least
    assert run.next_epoch("grabber") == 1


def serving_tasks(robot: Robot, *ended: str) -> LiveRobot:
    """Return a run of tasks that goes on, of which only `grabber` was found.

    `ended`: components that ran before.
    """
    run, agents, _ = run_of(robot)
    record = Desired(tasks=b"some", ended=dict.fromkeys(ended, 3))
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    for computer, told in layout.deployments(
        Desired(coming=LEFT[:1], generation=5), {}
    ).items():
        agents.begin_deploy(computer, structs.replace(told, desired=encode(record)))
    start_or_take_over(run, by_force=False)
    return run


def test_starts_what_an_architecture_lacks_that_serves_a_task(robot: Robot) -> None:
    eye, *_ = robot.architectures
    names = {component.name for component in eye.components}
    assert serving_tasks(robot, "thinker").placement().keys() == names > {"grabber"}


def test_starts_what_is_new_in_the_robot_file(robot: Robot) -> None:
    """No task asks for it, for its action has begun; what ended does not come back."""
    assert serving_tasks(robot).placement()["thinker"] == "right"
    assert "thinker" not in serving_tasks(robot, "thinker").placement()


def test_parameters_of_what_does_not_run_are_kept_by_each_next_manager(
    robot: Robot,
) -> None:
    parameters = {"thinker": {"gain": 2}}
    run, agents, _ = run_of(robot)
    layout = DeploymentLayout(robot, "/run", code_version=version_of)
    ended = {"thinker": 3}
    record = encode(Desired(tasks=b"some", parameters=parameters, ended=ended))
    for computer, told in layout.deployments(
        Desired(coming=LEFT[:1], generation=5), {}
    ).items():
        agents.begin_deploy(computer, structs.replace(told, desired=record))
    start_or_take_over(run, by_force=False)
    assert "thinker" not in run.placed
    assert run.desired.parameters == parameters
    _, told = agents.deployed[-1]
    assert newest_record([told]).parameters == parameters


@pytest.mark.parametrize("votes", [False, True])
@pytest.mark.parametrize("by_force", [False, True])
@pytest.mark.parametrize("kind", [RunError, AlreadyManaged])
def test_only_who_may_take_over_is_told_to(
    robot: Robot,
    monkeypatch: pytest.MonkeyPatch,
    kind: type[RunError],
    *,
    by_force: bool,
    votes: bool,
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise kind("so it is")

    run, agents, _ = run_of(robot, *LEFT)
    if votes:
        agents.vote(Deployment(generation=6, containers=()))
    monkeypatch.setattr(agents, "claim", refuse)
    monkeypatch.setattr(agents, "elect", refuse)
    with pytest.raises(kind) as told:
        start_or_take_over(run, by_force=by_force)
    may = kind is AlreadyManaged and not by_force
    way_out = "; `poise stop` ends the robot, and `poise up --take-over` takes it over"
    assert str(told.value) == f"so it is{way_out if may else ''}"


def test_what_was_replaced_begins_again_with_its_other_code(robot: Robot) -> None:
    """Also for the next manager; but not once the robot file has another class."""
    run, agents, _ = run_of(robot, *LEFT)
    start_or_take_over(run, by_force=False)
    other = structs.replace(LEFT[1], epoch=9, implementation="mind:Other", code="2f")
    run.commit(run.desired.placing([other]), "it is replaced")
    run.commit(run.desired.without(["thinker"]), "nothing needs it")
    again = run.begun("thinker", "right")
    assert (again.implementation, again.code) == ("mind:Other", "2f")
    for changed, begins in ((robot, "mind:Other"), (_with_class(robot, "m:New"), "")):
        follower, others, _ = run_of(changed)
        for computer, told in agents.deployed[-2:]:
            others.begin_deploy(computer, told)
        start_or_take_over(follower, by_force=False)
        assert follower.placed["thinker"].implementation == begins


def test_edited_code_does_not_pass_for_what_runs(robot: Robot, tmp_path: Path) -> None:
    """A container has imported the earlier one, also for a later incarnation."""
    module = tmp_path / "mind.py"
    module.write_text("class Thinker: ...")
    robot = structs.replace(robot, folder=str(tmp_path))
    run, agents, _ = run_of(robot, *LEFT)
    start_or_take_over(run, by_force=False)
    module.write_text("class Thinker: good = True")
    with pytest.raises(UsageError, match="'thinker' was edited since it was read"):
        plan_replacement(run, "thinker", "mind:Thinker")
    moved = Incarnation(component="thinker", computer="right", epoch=9)
    run.commit(run.desired.placing([moved]), "it is moved")
    follower, others, journal = run_of(robot)
    for computer, told in agents.deployed[-2:]:
        others.begin_deploy(computer, told)
    start_or_take_over(follower, by_force=False)
    assert any("its code has changed" in each for each in sentences(journal))
    plan_replacement(follower, "thinker", "mind:Thinker")  # the present code


def _with_class(robot: Robot, implementation: str) -> Robot:
    return robot.with_components(
        lambda c: (
            structs.replace(c, implementation=implementation)
            if c.name == "thinker"
            else c
        )
    )


def test_starts_layers_that_never_stop(robot: Robot) -> None:
    eye, *others = robot.architectures
    fixed = tuple(structs.replace(each, layer="reactive") for each in others)
    run = serving_tasks(structs.replace(robot, architectures=(eye, *fixed)), "thinker")
    assert run.placement()["thinker"] == "right"


def test_what_may_not_run_where_it_was_found_restarts_where_it_may(
    robot: Robot,
) -> None:
    moved = robot.with_components(
        lambda c: (
            structs.replace(c, only=("right",), devices=())
            if c.name == "grabber"
            else c
        )
    )
    assert serving_tasks(moved).placement()["grabber"] == "right"


def test_what_is_lacking_starts_where_there_is_room(robot: Robot) -> None:
    needs = {"grabber": 0.6, "heavy": 0.6}
    free = robot.with_components(
        lambda c: structs.replace(
            c, only=(), devices=(), demand={"cpu": needs.get(c.name, 0.0)}
        )
    )
    cores = tuple(
        structs.replace(c, capacity={"cpu": 1.0}, speed=1.0) for c in free.computers
    )
    placement = serving_tasks(structs.replace(free, computers=cores)).placement()
    assert placement["grabber"] == "left"
    assert placement["heavy"] == "right"


def test_a_manager_that_has_a_successor_leaves_the_robot_as_it_is(
    robot: Robot,
) -> None:
    run, agents, journal = run_of(robot)
    run.start()
    estimates = Estimates(robot, None, emulated=True)
    manager = Manager(run, Saved(), estimates, Recording())
    assert not manager.status().deviations
    agents.later = LATER
    # it says so from then on, also while it waits for something
    said = manager.status().deviations[0]
    assert "bob" in said.what
    assert "may be out of date" in said.what
    assert said.since == LATER.since
    with pytest.raises(TakenOver, match=r"user bob on desk \(process 8\) since"):
        manager.work(0.0)
    agents.later = None  # the other one has ended
    assert manager.status().deviations[0] == said
    manager.stop()
    assert all(status.containers for status in agents.statuses().values())
    assert "has taken over the robot" in sentences(journal)[-1]


def test_the_newest_record_is_that_of_the_latest_term() -> None:
    """A leader of before may have told a few agents more, which nobody was answered."""

    def stored(term: int, generation: int, held: str) -> Deployment:
        record = encode(Desired(held=frozenset({held})))
        return Deployment(
            generation=generation, containers=(), term=term, desired=record
        )

    found = [stored(1, 9, "old"), stored(2, 3, "new"), stored(2, 2, "before")]
    assert newest_record(found).held == {"new"}
    assert newest_record([]) == Desired()


def standby_of(robot: Robot, record: Desired) -> tuple[LiveRobot, FakeAgents, Journal]:
    """Return a standby's run, whose agents stored a record, and run nothing."""
    _, agents, journal = run_of(robot)
    stored = Deployment(generation=6, containers=(), term=3, desired=encode(record))
    agents.vote(stored)
    return (
        LiveRobot(robot, {}, cast("Agents", agents), journal, "/run"),
        agents,
        journal,
    )


def test_a_standby_leads_a_robot_that_runs_nothing(robot: Robot) -> None:
    """Its tasks have ended: the next one is started by a command."""
    run, _, journal = standby_of(robot, Desired(generation=6))
    start_or_take_over(run, follows=True)
    assert not run.placement()
    assert run.has_taken_over
    assert "took over" in sentences(journal)


def test_a_standby_remembers_what_had_begun_for_an_action_that_did_not(
    robot: Robot,
) -> None:
    """The leader before was gone in between; it may be at work out of reach."""
    begun = LEFT[1]
    record = Desired(placed={"grabber": LEFT[0]}, coming=(begun,), generation=6)
    run, agents, _ = standby_of(robot, record)
    agents.gone.add("left")
    start_or_take_over(run, follows=True)
    assert "thinker" not in run.placed
    assert begun.key in {each.key for each in run.desired.left_behind}


def test_leases_that_a_standby_waits_for_have_ended_at_the_same_time(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is heard anew while others' leases last may have its own again."""
    clock, third = VirtualClock(), Computer(name="third", capacity={"cpu": 1.0})
    lasts = {"left": (0.1, 0.5), "right": (0.0, 0.3)}

    def have_leases_ended(computers: Collection[str]) -> bool:
        now = clock.now() - began
        return not any(lasts[c][0] <= now < lasts[c][1] for c in computers)

    began = clock.now()
    agents = FakeAgents("left", "right", "third")
    record = Desired(placed={"thinker": LEFT[1]}, generation=6)
    agents.vote(Deployment(generation=6, containers=(), desired=encode(record)))
    agents.gone = {"left", "right"}
    monkeypatch.setattr(agents, "have_leases_ended", have_leases_ended)
    robot = structs.replace(robot, computers=(*robot.computers, third))
    journal = Journal(":memory:")
    run = LiveRobot(robot, {}, cast("Agents", agents), journal, "/run", clock=clock)
    start_or_take_over(run, follows=True)
    assert clock.now() - began == pytest.approx(0.5, abs=0.1)


def test_a_standby_that_does_not_know_of_a_stop_finishes_it(robot: Robot) -> None:
    run, agents, _ = standby_of(robot, Desired(generation=6, is_stopped=True))
    with pytest.raises(RunError, match="the robot was stopped"):
        start_or_take_over(run, follows=True)
    told = dict(agents.deployed)
    assert told.keys() == {"left", "right"}
    assert all(deployment.is_last for deployment in told.values())


def test_a_robot_that_was_stopped_starts_again(robot: Robot) -> None:
    _, agents, journal = standby_of(robot, Desired(generation=6, is_stopped=True))
    live = LiveRobot(robot, PLACEMENT, cast("Agents", agents), journal, "/run")
    start_or_take_over(live)
    assert live.placement() == PLACEMENT
    assert sentences(journal)[-1] == "all components run"


def test_who_does_not_answer_is_asked_again_whether_a_move_was_committed(
    robot: Robot,
) -> None:
    """Only the sender, which answers late, knows that the target counts."""
    source = structs.replace(LEFT[1], goal="stay")
    target = structs.replace(LEFT[1], computer="right", epoch=5, goal="inactive")
    run, agents, _ = run_of(robot, LEFT[0], source, target)
    run.clock = VirtualClock()
    sender = run.layout.container_of(LEFT[0])
    asked: list[list[str]] = []

    def send_steps(
        batches: Iterable[tuple[str, MigrationSteps]],
    ) -> Iterator[StepsOutcome]:
        batches = list(batches)
        asked.append([steps.container for _, steps in batches])
        for _, steps in batches:
            if steps.container != sender:
                yield StepsDone(steps.number)
            elif len(asked) == 1:
                yield StepsFailed(steps.number, "it does not answer")
            else:
                targets = (("thinker", 5), ("grabber", 0))
                yield StepsDone(steps.number, targets=targets, is_committed=True)

    agents.send_steps = send_steps  # type: ignore[method-assign]
    start_or_take_over(run, by_force=False)
    assert run.placement() == {"grabber": "left", "thinker": "right"}
    assert asked[1:] == [[sender]]


def test_who_was_cut_off_is_claimed_again_before_it_is_asked_about_a_move(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else it refuses all, also the request to stop what may have gone on."""
    source = structs.replace(LEFT[1], goal="stay")
    target = structs.replace(LEFT[1], computer="right", epoch=5, goal="inactive")
    run, agents, _ = run_of(robot, LEFT[0], source, target)
    run.clock = VirtualClock()

    def is_cut_off(computer: str) -> bool:
        return computer == "right" and agents.claimed.count("right") == 1

    def send_steps(
        batches: Iterable[tuple[str, MigrationSteps]],
    ) -> Iterator[StepsOutcome]:
        for computer, steps in batches:
            if is_cut_off(computer):
                yield StepsFailed(steps.number, "the lease of 'right' ended")
            else:
                yield StepsDone(steps.number)

    monkeypatch.setattr(agents, "is_cut_off", is_cut_off)
    monkeypatch.setattr(agents, "send_steps", send_steps)
    start_or_take_over(run, by_force=False)
    assert agents.claimed.count("right") == 2
    assert run.placement() == {"grabber": "left", "thinker": "left"}


def test_who_is_replaced_while_it_starts_what_is_missing_leaves_the_robot(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What obeys the other one refuses this one: it would wait for it in vain."""
    run, agents, _ = run_of(robot, LEFT[0])
    bring = run.bring

    def bring_late(*args: Any) -> None:
        agents.later = LATER
        bring(*args)

    monkeypatch.setattr(run, "bring", bring_late)
    with pytest.raises(TakenOver, match=r"bob on desk .* has taken over the robot"):
        start_or_take_over(run, by_force=False)
    assert run.is_left


def test_a_replacement_that_had_not_begun_counts_for_nothing_on_a_computer_that_is_away(
    robot: Robot,
) -> None:
    """What it was to replace may still be at work there."""
    other = Architecture(
        name="instinct",
        function="thinking",
        components=(
            ComponentEntry(name="reflex", implementation="mind:Reflex"),
            ComponentEntry(name="muscle", implementation="mind:Muscle"),
        ),
    )
    robot = structs.replace(robot, architectures=(*robot.architectures, other))
    thinker = LEFT[1]
    ahead = tuple(
        Incarnation(component=name, computer=computer, epoch=7, goal="inactive")
        for name, computer in (("reflex", "right"), ("muscle", "left"))
    )
    record = Desired(placed={"thinker": thinker}, configured_ahead=ahead, generation=5)
    agents, layout = FakeAgents("left", "right"), DeploymentLayout(robot, "/run")
    told = layout.deployments(Desired(coming=(thinker, *ahead), generation=5), {})[
        "right"
    ]
    agents.begin_deploy("right", structs.replace(told, desired=encode(record)))
    agents.gone = {"left"}
    run = LiveRobot(
        robot, {"thinker": "left"}, cast("Agents", agents), Journal(":memory:"), "/run"
    )
    start_or_take_over(run, by_force=False)
    assert run.placement() == {"thinker": "left"}


def test_who_is_replaced_while_it_asks_about_a_move_leaves_the_robot(
    robot: Robot,
) -> None:
    """What it found before the other one began may have been moved since."""
    source = structs.replace(LEFT[1], goal="stay")
    target = structs.replace(LEFT[1], computer="right", epoch=5, goal="inactive")
    run, agents, _ = run_of(robot, LEFT[0], source, target)
    told = len(agents.deployed)

    def send_steps(
        batches: Iterable[tuple[str, MigrationSteps]],
    ) -> Iterator[StepsOutcome]:
        agents.later = LATER
        for _, steps in batches:
            yield StepsFailed(steps.number, "the robot is managed by another one")

    agents.send_steps = send_steps  # type: ignore[method-assign]
    with pytest.raises(RunError, match=r"bob on desk .* has taken over the robot"):
        start_or_take_over(run, by_force=False)
    assert run.is_left
    assert len(agents.deployed) == told
