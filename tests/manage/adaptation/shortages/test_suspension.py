"""Architectures are suspended by priority, and taken back when there is room."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.estimate.online import Estimate
from poise.manage.adaptation.decision import decide
from poise.manage.adaptation.placement_responders import (
    FailoverResponder,
    plan_failover,
)
from poise.manage.adaptation.policies import Symptom
from poise.manage.adaptation.situation import Responder, Situation
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.observe.estimates import DemandEstimate, Load
from poise.manage.shortages import suspension
from poise.manage.shortages.suspension import (
    CALM,
    DOUBT_AFTER,
    FIRST,
    ResumeSuspended,
    Suspensions,
    not_running,
)
from poise.model.policy import ComputerValues, Policy, TimerValues
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Robot,
    Task,
)
from tests.manage.conftest import FakeAgents

HIGH = {"high": "left"}
BOTH = {"high": "left", "low": "left"}


def robot_with(high: int = 10, low: int = 1, layer: str = "sequencing") -> Robot:
    """Return two architectures of 0.4 cores each, and a computer of one core."""
    return Robot(
        name="two",
        computers=(Computer(name="left", capacity={"cpu": 1.0, "memory": 1e9}),),
        architectures=tuple(
            Architecture(
                name=f"{name}-task",
                function=name,
                priority=priority,
                layer=layer,  # type: ignore[arg-type] # of a test's parameter
                home="left",
                components=(
                    ComponentEntry(
                        name=name, implementation="a:B", demand={"cpu": 0.4}
                    ),
                ),
            )
            for name, priority in (("high", high), ("low", low))
        ),
        tasks=(
            Task(
                name="work",
                actions=(Action(name="w", functions=("high", "low")),),
            ),
        ),
    )


class Robbed:
    """A robot that runs, and what is suspended of it."""

    def __init__(self, robot: Robot, placement: Mapping[str, str] = BOTH) -> None:
        self.agents = FakeAgents(*(computer.name for computer in robot.computers))
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(robot, placement, agents, self.journal, "/run")
        self.run.start()
        self.task = robot.task("work")
        self.suspensions = Suspensions(self.run, lambda: (self.task,), "not all fits")
        self.taking_back = ResumeSuspended(self.run, self.suspensions)

    def situation(self, background: float = 0.0, *late: str) -> Situation:
        """Return situation with a load of other programs, and late components."""
        load = Load(capacity=1.0, used=min(1.0, background), background=background)
        held = self.run.desired.held
        placement = self.run.placement().items()
        return Situation(
            robot=self.run.robot,
            placement={name: at for name, at in placement if name not in held},
            loads={"left": load},
            misses=tuple(
                TimerValues(
                    name=f"{name}.t",
                    component=name,
                    computer="left",
                    timer="t",
                    late=True,
                )
                for name in late
            ),
        )

    def take_back(self, now: float, background: float = 0.0) -> bool:
        """Look, and take back what fits."""
        self.suspensions.record()
        return self.respond(self.taking_back, self.situation(background), now)

    def respond(self, responder: Responder, situation: Situation, now: float) -> bool:
        """Let a responder do what it wants; return whether it wanted something."""
        situation = replace(situation, now=now)
        change = responder.respond(situation, self.run.desired)
        if change is not None:
            self.journal.note("decided", change.why)
            change.carry_out()
        return change is not None

    def lose(self, responder: Responder, now: float, *computers: str) -> bool:
        """Lose computers, and let a responder do what it wants, as by `respond`."""
        self.agents.gone |= {*computers}
        policy = Policy(name="lost", for_each="computer", when="lost", do="fail over")
        symptoms = tuple(
            Symptom(
                policy=policy,
                what="it is lost",
                values=ComputerValues(name=name, lost=True),
            )
            for name in computers
        )
        seen = replace(self.situation(), lost=frozenset(computers), symptoms=symptoms)
        return self.respond(responder, seen, now)

    def sentences(self) -> list[str]:
        """Return what the journal says of architectures."""
        entries = self.journal.entries()
        return [e.what for e in entries if "architecture" in e.what]


def test_what_it_needed_last_is_not_believed_for_ever() -> None:
    robbed = Robbed(robot_with())
    assert robbed.suspensions.suspend(["low-task"], "overloaded", 0.0)
    grown = DemandEstimate(
        component="low",
        computer="left",
        expected=0.4,
        estimate=Estimate(mean=0.9, p95=0.9, error=0.01),
    )

    def take_back(now: float) -> bool:
        robbed.suspensions.record()
        situation = replace(robbed.situation(), demand_estimates=(grown,))
        return robbed.respond(robbed.taking_back, situation, now)

    assert not take_back(0.0)
    assert not take_back(FIRST)
    assert not take_back(FIRST + DOUBT_AFTER - 1)
    assert take_back(FIRST + DOUBT_AFTER)
    assert robbed.run.placement() == BOTH
    assert robbed.suspensions.suspend(["low-task"], "overloaded", 200.0)
    robbed.suspensions.release()
    assert take_back(201.0)


def test_what_is_put_aside_stops_and_is_said() -> None:
    robbed = Robbed(robot_with())
    assert robbed.suspensions.suspend(["low-task"], "it crashes", 0.0)
    assert robbed.run.placement() == HIGH
    (deviation,) = robbed.suspensions.deviations()
    assert deviation.what == "architecture 'low-task' is suspended: it crashes"
    assert robbed.sentences() == [deviation.what]


def test_it_is_taken_back_when_there_is_room_and_nothing_is_wrong() -> None:
    robbed = Robbed(robot_with())
    robbed.suspensions.suspend(["low-task"], "it crashes", 0.0)
    assert not robbed.take_back(FIRST - CALM)  # since now nothing is wrong
    assert not robbed.take_back(FIRST - 0.1)
    assert robbed.take_back(FIRST)
    assert robbed.run.placement() == BOTH
    robbed.suspensions.record()
    assert not robbed.suspensions.deviations()
    assert robbed.sentences()[-1] == "architecture 'low-task' runs again"


@pytest.mark.parametrize("about", ["low", "low-task"])
def test_what_a_function_wants_suspended_is_not_taken_back(about: str) -> None:
    """It alternated with "there is room", up to every 5 minutes, for ever."""
    robbed = Robbed(robot_with())
    robbed.suspensions.suspend(["low-task"], "somebody sleeps", 0.0)
    seen = robbed.situation()
    wanted = replace(seen, suspends=frozenset({about}))
    for now in 0.0, FIRST, 100.0:
        assert not robbed.respond(robbed.taking_back, wanted, now)
    assert robbed.respond(robbed.taking_back, seen, 100.0)


def test_what_runs_is_not_disturbed_when_it_is_taken_back() -> None:
    robbed = Robbed(robot_with(), HIGH)
    before = robbed.run.placed["high"]
    assert not robbed.take_back(0.0)
    assert robbed.take_back(CALM)
    assert robbed.run.placed["high"] is before


def test_other_programs_count_for_more_before_it_is_taken_back() -> None:
    # 1 - 0.4 - 0.4 = 0.2 are left; other programs that take 0.15 may want 0.225
    robbed = Robbed(robot_with(), HIGH)
    robbed.take_back(0.0, 0.15)
    assert not robbed.take_back(100.0, 0.15)
    assert robbed.take_back(200.0, 0.13)


def test_room_is_looked_for_less_and_less_until_something_is_new(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Since 0 s nothing is wrong; 0.6 of 1 are taken, and both need 0.8."""
    robbed = Robbed(robot_with(), HIGH)
    now, looks = 0.0, list[float]()

    def no_room(*_: object) -> dict[str, str]:
        looks.append(now)
        return {}

    def looks_until(end: float, lost: frozenset[str] = frozenset()) -> list[float]:
        nonlocal now
        looks.clear()
        robbed.suspensions.record()
        while now < end:
            situation = replace(robbed.situation(0.6), lost=lost)
            assert not robbed.respond(robbed.taking_back, situation, now)
            now += 0.5
        return list(looks)

    monkeypatch.setattr(suspension, "room_for_components", no_room)
    assert looks_until(60.0) == [CALM, 7.0, 11.0, 19.0, 35.0]
    assert looks_until(70.0, frozenset({"other"})) == [60.0, 62.0, 66.0]
    assert looks_until(73.0, frozenset({"other"})) == []
    robbed.suspensions.release()  # a person asked
    assert looks_until(80.0, frozenset({"other"})) == [73.0]


def test_nothing_is_taken_back_while_something_is_wrong() -> None:
    robbed = Robbed(robot_with(), HIGH)
    robbed.suspensions.record()
    bad = Symptom(
        policy=Policy(name="p", for_each="computer", when="full", do="replan"),
        what="it is full",
        values=ComputerValues(name="left", used=1.0),
    )
    wrong = replace(robbed.situation(), symptoms=(bad,))
    for now in range(100):
        assert not robbed.respond(robbed.taking_back, wrong, now)
    after = 99.0 + 2 * CALM  # what was done about it took so long
    assert not robbed.take_back(after)  # it is calm since now
    assert robbed.take_back(after + CALM)


def test_what_is_put_aside_again_stays_aside_for_longer() -> None:
    robbed = Robbed(robot_with())
    robbed.suspensions.suspend(["low-task"], "it crashes", 0.0)
    robbed.take_back(1.0)
    assert robbed.take_back(FIRST)
    robbed.suspensions.suspend(["low-task"], "it crashes", 20.0)
    assert not robbed.take_back(20.0 + FIRST)
    assert robbed.take_back(20.0 + 2 * FIRST)


def test_what_is_not_needed_any_more_is_not_said_to_run() -> None:
    """Its task ended meanwhile."""
    robbed = Robbed(robot_with())
    robbed.suspensions.suspend(["low-task"], "it crashes", 0.0)
    (task,) = robbed.run.robot.tasks
    robbed.task = replace(task, actions=())
    robbed.suspensions.record()
    assert not robbed.suspensions.deviations()
    assert robbed.sentences()[-1] == "architecture 'low-task' is not needed any more"


def test_what_is_aside_from_the_start_is_said() -> None:
    robbed = Robbed(robot_with(), HIGH)
    robbed.suspensions.record()
    assert robbed.sentences() == ["architecture 'low-task' is suspended: not all fits"]


@pytest.mark.parametrize("layer", ["reactive", "deliberative"])
def test_other_layers_are_never_put_aside(layer: str) -> None:
    robbed = Robbed(robot_with(layer=layer))
    with pytest.raises(UsageError, match=f"{layer} layer, which Poise never suspends"):
        robbed.suspensions.suspend(["low-task"], "it crashes", 0.0)
    assert robbed.run.placement() == BOTH
    assert not_running(robbed.run.robot, HIGH) == []


def test_an_overload_that_no_placement_helps_puts_the_lowest_aside() -> None:
    decision = decide(Robbed(robot_with()).situation(0.3, "high", "low"))
    assert decision.acts
    assert decision.why == "not all fits without 'low-task' (priority 1)"
    assert decision.proposal is not None
    assert decision.proposal.placement == HIGH
    assert [str(step) for step in decision.proposal.steps] == ["stop low on left"]


def test_nothing_is_put_aside_while_the_higher_keep_their_deadlines() -> None:
    decision = decide(Robbed(robot_with()).situation(0.3, "low"))
    assert not decision.acts
    assert decision.why.startswith("no placement can help")


def test_of_equal_priorities_none_is_put_aside() -> None:
    decision = decide(Robbed(robot_with(1, 1)).situation(0.3, "high", "low"))
    assert not decision.acts
    assert decision.why.startswith("no placement can help")


@pytest.mark.parametrize("layer", ["reactive", "deliberative"])
def test_an_overload_puts_no_other_layer_aside(layer: str) -> None:
    decision = decide(Robbed(robot_with(layer=layer)).situation(0.3, "high", "low"))
    assert not decision.acts


def test_of_alternatives_the_best_that_fits_is_taken_back() -> None:
    robot = robot_with()
    high, low = robot.architectures
    big = ComponentEntry(name="big", implementation="a:B", demand={"cpu": 0.7})
    better = replace(low, name="big-task", components=(big,))
    low = replace(low, quality=0.5)
    robbed = Robbed(replace(robot, architectures=(high, low, better)), HIGH)
    robbed.take_back(0.0)
    assert robbed.take_back(CALM)
    assert robbed.run.placement() == BOTH
    robbed.suspensions.record()
    assert not robbed.suspensions.deviations()


def test_a_lost_computer_puts_lower_priorities_aside_for_higher_ones() -> None:
    robot = robot_with()
    high, low = robot.architectures
    middle = replace(
        low,
        name="middle-task",
        function="middle",
        priority=5,
        components=(replace(low.components[0], name="middle"),),
    )
    right = Computer(name="right", capacity={"cpu": 1.0, "memory": 1e9})
    robot = replace(
        robot,
        computers=(*robot.computers, right),
        architectures=(high, low, middle),
    ).with_components(lambda c: replace(c, demand={"cpu": 0.4, "memory": 4e8}))
    situation = Situation(
        robot=robot,
        placement={"high": "right", "middle": "left", "low": "left"},
        lost=frozenset({"right"}),
    )
    found = plan_failover(situation, {"right"})
    assert (found.placement, found.suspended) == ({"high": "left"}, ("low-task",))
    assert not found.missing
    # the lowest itself gets only what is left
    swapped = replace(
        situation, placement={"low": "right", "middle": "left", "high": "left"}
    )
    found = plan_failover(swapped, {"right"})
    assert (found.placement, found.suspended) == ({}, ())
    assert found.missing["low"].startswith(
        "it fits nowhere beside the running components"
    )


def with_little_memory(placement: Mapping[str, str]) -> Robbed:
    """Return a robot of two computers; `high` has room where `low` has none.

    `low` and `small` are one architecture.
    """
    robot = robot_with()
    high, low = robot.architectures
    (part,) = low.components
    low = replace(low, components=(part, replace(part, name="small")))
    right = Computer(name="right", capacity={"cpu": 1.0, "memory": 1e9})
    memory = {"high": 8e8, "low": 4e8, "small": 1e7}
    robot = replace(
        robot, computers=(*robot.computers, right), architectures=(high, low)
    ).with_components(lambda c: replace(c, demand={"memory": memory[c.name]}))
    robbed = Robbed(robot, placement)
    robbed.run.goes_on_without_lost = True
    return robbed


def test_what_makes_room_for_lost_components_is_suspended_wholly() -> None:
    """Also its component on the lost computer, though that would fit elsewhere."""
    robbed = with_little_memory({"high": "right", "low": "left", "small": "right"})
    failover = FailoverResponder(robbed.run, robbed.suspensions)
    assert robbed.lose(failover, 0.0, "right")
    assert robbed.run.placement() == {"high": "left"}
    robbed.suspensions.record()
    (deviation,) = robbed.suspensions.deviations()
    assert deviation.what.startswith("architecture 'low-task' is suspended")


def test_nothing_restarts_where_what_was_to_make_room_does_not_stop() -> None:
    robbed = with_little_memory({"high": "right", "low": "left", "small": "left"})
    robbed.agents.deaf.add("left")
    failover = FailoverResponder(robbed.run, robbed.suspensions)
    assert robbed.lose(failover, 0.0, "right")
    assert robbed.run.placement()["high"] == "right"
    assert not [e for e in robbed.journal.entries() if "start components" in e.what]


def test_another_loss_does_not_wait_because_a_restart_failed_before() -> None:
    """Nothing starts elsewhere at first, and it is tried less and less often."""
    names = ("left", "right", "third")
    robot = robot_with()
    (left,) = robot.computers
    robot = replace(robot, computers=tuple(replace(left, name=n) for n in names))
    robbed = Robbed(robot, {"high": "left", "low": "right"})
    robbed.run.goes_on_without_lost = True
    failover = FailoverResponder(robbed.run, robbed.suspensions)
    robbed.agents.deaf |= {"right", "third"}
    assert robbed.lose(failover, 0.0, "left")
    assert robbed.lose(failover, 2.0, "left")
    robbed.agents.deaf.clear()
    assert not robbed.lose(failover, 3.0, "left")
    assert robbed.lose(failover, 3.2, "left", "right")
    assert robbed.run.placement() == {"high": "third", "low": "third"}


def test_of_what_was_lost_the_higher_is_restarted_when_not_all_fits() -> None:
    robot = robot_with().with_components(
        lambda c: replace(c, demand={"cpu": 0.1, "memory": 4e8})
    )
    left = Computer(name="small", capacity={"cpu": 0.5, "memory": 5e8})
    situation = Situation(
        robot=replace(robot, computers=(*robot.computers, left)),
        placement=BOTH,
        lost=frozenset({"left"}),
    )
    found = plan_failover(situation, {"left"})
    assert found.placement == {"high": "small"}
    assert set(found.missing) == {"low"}
