"""What a simulation tells a user: shares, deadlines, ages, moves and outages."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec import structs

from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Distribution,
    Profile,
    TimerProfile,
)
from poise.model.hardware import Link
from poise.model.policy import Policy
from poise.model.robot import Action, Chain, Robot, Task
from poise.model.software import ConnectorEnd
from poise.simulation.faults import SimulatedFault
from poise.simulation.rehearsal import Rehearsal, RehearsalPlan
from poise.simulation.simulation_observer import SimulationObserver
from poise.simulation.simulation_report import SimulationReport
from tests.simulation.conftest import small_scenario

PERIOD = 0.1


def profile_of(robot: Robot, **cpu: float) -> Profile:
    """Return a profile of components with timers of 10 Hz that feed all connectors."""
    components = {
        entry.name: ComponentProfile(
            version="1",
            cpu=Distribution(mean=cpu.get(entry.name, 0.1)),
            start=0.1,
            memory=1e6,
            timers={"tick": TimerProfile(period=PERIOD, median=0.0, p99=0, maximum=0)},
        )
        for entry in robot.components()
    }
    connectors = {
        str(each): ConnectorProfile(messages=1 / PERIOD, size=1000)
        for each in robot.all_connectors()
    }
    return Profile(
        robot=robot.name,
        poise="1",
        computer="a",
        speed=1.0,
        at="",
        seconds=1.0,
        components=components,
        connectors=connectors,
    )


def plan_of(**cpu: float) -> RehearsalPlan:
    scenario = small_scenario()
    demands = {name: {"cpu": cores, "memory": 1e6} for name, cores in cpu.items()}
    robot = scenario.robot.with_components(
        lambda c: structs.replace(c, demand=demands.get(c.name, c.demand))
    )
    return RehearsalPlan(
        robot=robot,
        placement=scenario.placement,
        method="static",
        tasks=("work",),
        profile=profile_of(robot, **cpu),
    )


def rehearsed(plan: RehearsalPlan, seconds: float = 20.0) -> SimulationReport:
    rehearsal = Rehearsal(structs.replace(plan, seconds=seconds), seed=1)
    rehearsal.come_up()
    rehearsal.advance(seconds)
    report = rehearsal.report()
    rehearsal.close()
    assert report.violations == ()
    return report


def slow(robot: Robot, **computers: tuple[float, float]) -> Robot:
    """Return the robot with other cores and speeds of computers."""
    return structs.replace(
        robot,
        computers=tuple(
            structs.replace(
                each,
                capacity={**each.capacity, "cpu": computers[each.name][0]},
                speed=computers[each.name][1],
            )
            if each.name in computers
            else each
            for each in robot.computers
        ),
    )


@pytest.mark.slow
def test_shares_are_work_by_capacity_and_speed() -> None:
    """Of a core of half speed a component of 0.2 reference cores takes 0.4."""
    plan = plan_of(camera=0.2, filter=0.1, mind=0.3, arm=0.3)
    plan = structs.replace(plan, robot=slow(plan.robot, a=(1.0, 0.5)))
    report = rehearsed(plan)
    shares = {load.computer: load.cpu for load in report.loads}
    # `filter` and `mind` have 0.4 of the two cores of b, `arm` 0.3 of those of c
    assert shares == pytest.approx({"a": 0.4, "b": 0.2, "c": 0.15}, rel=0.1)
    assert report.messages == pytest.approx(3 * 20 / PERIOD, rel=0.05)
    assert report.missed == 0
    assert report.due == pytest.approx(4 * 20 / PERIOD, rel=0.05)


@pytest.mark.parametrize(("address", "used"), [(None, 0.004), ("10.0.0.1", 0.002)])
def test_an_emulated_computer_is_as_quick_as_the_machine(
    address: str | None, used: float
) -> None:
    """Then it stands: so `poise run` and `poise plan` have it, too."""
    plan = plan_of()
    robot = slow(plan.robot, a=(1.0, 0.5))
    computers = tuple(structs.replace(c, address=address) for c in robot.computers)
    robot = structs.replace(robot, computers=computers)
    simulated = Rehearsal(structs.replace(plan, robot=robot))._robot
    group = simulated.computers["a"].cpu.group()
    group.run(0.01)
    simulated.scheduler.engine.run(0.004)
    assert group.used == pytest.approx(used)


@pytest.mark.parametrize("seconds", [0.5, 1.0, 1.5])
def test_the_last_second_counts_and_what_is_left_of_one(seconds: float) -> None:
    plan = plan_of(camera=0.2)
    report = rehearsed(
        structs.replace(plan, robot=slow(plan.robot, a=(1.0, 1.0))), seconds
    )
    load = report.loads[0]
    assert load.cpu == pytest.approx(0.2, rel=0.3)
    assert load.peak >= load.cpu
    assert [at for at, _ in load.over_time] == pytest.approx([1.0] * (seconds >= 1))


@pytest.mark.slow
def test_one_that_gets_too_little_misses_deadlines_and_is_moved() -> None:
    plan = plan_of(camera=0.05, filter=0.9, mind=0.9, arm=0.05)
    plan = structs.replace(plan, robot=slow(plan.robot, b=(1.0, 1.0)))
    stays = rehearsed(structs.replace(plan, adapts=False))
    assert stays.missed > 0.3 * stays.due / 4
    assert not stays.moves
    moved = rehearsed(plan)
    assert {move.component for move in moved.moves} & {"filter", "mind"}
    assert moved.missed < stays.missed / 2
    move = moved.moves[0]
    assert (move.kind, move.before) == ("move", "b")
    assert 0 < move.downtime < 0.5


@pytest.mark.slow
def test_what_a_lost_computer_ran_is_out_for_about_a_second() -> None:
    fault = SimulatedFault(5.0, "isolate computer", "c", lasts=8.0)
    report = rehearsed(structs.replace(plan_of(), faults=(fault,)))
    outage = report.outages[0]
    assert (outage.function, outage.components) == ("acting", ("arm",))
    assert outage.at == pytest.approx(5.5, abs=0.5)  # it works until its lease ends
    assert 0.2 < outage.lasts < 2.0
    restart = report.moves[0]
    assert (restart.kind, restart.component, restart.before) == ("restart", "arm", "c")
    assert restart.downtime == pytest.approx(outage.lasts, abs=0.1)
    assert [e.what for e in report.events if e.who == "fault"] == [str(fault)]


@pytest.mark.slow
def test_a_function_whose_action_has_ended_did_not_stop() -> None:
    """After 5 s the action fails, and its alternative needs no arm; a loss counts."""
    plan = plan_of()
    (work,) = plan.robot.tasks
    look = Action(name="look", functions=("seeing", "thinking"))
    (go,) = work.actions
    assert isinstance(go, Action)
    go = structs.replace(go, limit=5.0, on_failure=look)
    robot = structs.replace(plan.robot, tasks=(structs.replace(work, actions=(go,)),))
    plan = structs.replace(plan, robot=robot)
    assert rehearsed(plan).outages == ()
    fault = SimulatedFault(10.0, "isolate computer", "b", lasts=2.0)
    lost = rehearsed(structs.replace(plan, faults=(fault,)))
    assert {outage.function for outage in lost.outages} == {"seeing", "thinking"}


@pytest.mark.parametrize(
    ("placed", "needed"),
    [({"hand": "a"}, {"hand"}), ({"arm": "c"}, {"arm"}), ({}, {"arm", "hand"})],
)
def test_what_an_alternative_does_instead_is_not_missed(
    placed: dict[str, str], needed: set[str]
) -> None:
    """An outage is over when an alternative provides the function."""
    robot = small_scenario().robot
    *others, act = robot.architectures
    (arm,) = act.components
    hand = structs.replace(arm, name="hand")
    lesser = structs.replace(act, name="grasp", components=(hand,))
    robot = structs.replace(robot, architectures=(*others, act, lesser))
    tasks = SimpleNamespace(functions_of=lambda _: {"acting"}, records=())
    manager = SimpleNamespace(tasks=SimpleNamespace(tasks=tasks))
    observer = SimulationObserver.__new__(SimulationObserver)
    fake: Any = SimpleNamespace(robot=robot, manager=SimpleNamespace(manager=manager))
    observer._robot = fake
    assert observer._needed(placed) == needed


@pytest.mark.parametrize(("latency", "misses"), [(0.001, False), (0.08, True)])
@pytest.mark.slow
def test_the_age_of_a_chain_has_its_links_in_it(latency: float, misses: bool) -> None:  # noqa: FBT001
    """Two hops of 80 ms, and 100 ms at most for each timer that samples the data."""
    plan = plan_of()
    chain = Chain(name="act", through=("camera", "filter", "mind", "arm"), deadline=0.4)
    links = tuple(
        Link(between=pair, latency=latency) for pair in (("a", "b"), ("b", "c"))
    )
    robot = structs.replace(plan.robot, chains=(chain,), links=links)
    report = rehearsed(structs.replace(plan, robot=robot))
    (age,) = report.chains
    assert age.uses > 100
    assert age.maximum > 2 * latency
    assert age.median < 3 * PERIOD + 2 * latency + 0.1
    assert (age.missed > 0) == misses


@pytest.mark.slow
def test_the_same_seed_tells_the_same() -> None:
    first, again = (rehearsed(plan_of(), 5.0) for _ in range(2))
    assert structs.replace(first, took=0) == structs.replace(again, took=0)


def test_a_component_without_code_is_said_to_be_guessed() -> None:
    report = rehearsed(plan_of(), 1.0)
    assert any("the code of 'arm' is not known" in guess for guess in report.guesses)


def test_an_action_that_its_component_ends_is_said_to_reach_its_limit() -> None:
    plan = plan_of()
    go, stay = (
        Action(name=name, functions=("seeing",), limit=9.0, ends=ends)
        for name, ends in (("go", ConnectorEnd("arm", "done")), ("stay", None))
    )
    tasks = (Task(name="work", actions=(go, stay)),)
    robot = structs.replace(plan.robot, tasks=tasks)
    first, *_ = rehearsed(structs.replace(plan, robot=robot), 0.1).guesses
    assert first.startswith("no component says that 'go' is done")
    assert not any("is done" in guess for guess in rehearsed(plan, 0.1).guesses)


def test_a_policys_function_is_not_asked_and_that_is_said() -> None:
    plan = plan_of()
    mine = Policy(name="mine", call="rules:decide")
    robot = structs.replace(plan.robot, policies=(*plan.robot.policies, mine))
    report = rehearsed(structs.replace(plan, robot=robot), 1.0)
    assert not any("rules:decide" in event.what for event in report.events)
    assert "'rules:decide' of policy 'mine' is not asked" in report.guesses[0]


@pytest.mark.slow
def test_what_is_simulated_is_not_learned(tmp_path: Path) -> None:
    """An action of 1 s fails: the real robot's choices do not depend on that."""
    plan = plan_of()
    action = Action(name="go", functions=("seeing",), limit=1.0)
    tasks = (Task(name="work", actions=(action,)),)
    robot = structs.replace(plan.robot, folder=str(tmp_path), tasks=tasks)
    report = rehearsed(structs.replace(plan, robot=robot), 3.0)
    (task,) = report.tasks
    assert (task.state, "its limit of 1 s is over" in task.why) == ("failed", True)
    assert task.since - task.began == pytest.approx(1.0, abs=0.6)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_was_due_while_a_lease_had_ended_goes_on() -> None:
    rehearsal = Rehearsal(structs.replace(plan_of(), seconds=20.0), seed=1)
    rehearsal.come_up()
    rehearsal.advance(1.0)
    containers = rehearsal._robot.containers()
    for _ in range(30):
        for container in containers:
            container.execution.set_lease_end(0.0)
            container.lease_end = 0.0
        rehearsal.advance(0.037)
    rehearsal.advance(1.0)
    before = rehearsal.report().messages
    rehearsal.advance(5.0)
    assert rehearsal.report().messages > before
    rehearsal.close()
