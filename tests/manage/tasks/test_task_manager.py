"""The task manager starts what actions need, and lets the rest rest or wait."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from msgspec.structs import replace

from poise.clock import boot_id, boot_time
from poise.errors import UsageError
from poise.estimate import success_rates
from poise.estimate.outcomes import outcomes_of
from poise.estimate.success_rates import beliefs_about
from poise.manage.adaptation.situation import Situation
from poise.manage.agent_connections.agents import Agents
from poise.manage.deploy.desired import Desired
from poise.manage.deploy.live_robot import ACTIVE_LIMIT, LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.move import plan_move
from poise.manage.observe.estimates import Load
from poise.manage.tasks import task_manager
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.manage.tasks.saved_tasks import goes_on_with
from poise.manage.tasks.switch import prepare
from poise.manage.tasks.task_manager import TaskManager
from poise.manage.tasks.task_progress import Saved
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    ConnectorEnd,
    Robot,
    Task,
)
from poise.model.steps import Choice, Parallel, Retry, Sequence, Step, Until
from poise.wire.records.status_records import (
    ActionEnd,
    AgentStatus,
    ComponentStatus,
    ContainerStatus,
    Fault,
    TaskRequest,
)
from tests.manage.conftest import FakeAgents

FUNCTIONS = ("see", "go", "say")


def act(name: str, *functions: str, **more: object) -> Action:
    ends = ConnectorEnd(f"{functions[0]}er", "done")
    return Action(name=name, functions=functions, ends=ends, **more)  # type: ignore[arg-type] # of a test


def robot_with(
    *tasks: Task, cpu: float = 1.0, memory: float = 1e9, linger: float | None = None
) -> Robot:
    """Return a computer, and functions that need 0.4 cores and 0.3 GB each."""
    return Robot(
        name="r",
        computers=(
            Computer(name="main", capacity={"cpu": cpu, "memory": memory}),
            Computer(name="spare", capacity={"cpu": 0.1, "memory": memory}),
        ),
        architectures=tuple(
            Architecture(
                name=f"{function}-arch",
                function=function,
                linger=linger,
                components=(
                    ComponentEntry(
                        name=f"{function}er",
                        implementation="a:B",
                        demand={"cpu": 0.4, "memory": 3e8},
                        only=("main",),
                    ),
                ),
            )
            for function in FUNCTIONS
        ),
        tasks=tasks,
    )


def task(name: str, *steps: Step, priority: int = 0) -> Task:
    return Task(name=name, actions=steps, priority=priority)


class Speaking(FakeAgents):
    """Agents whose components say what a test wants."""

    def __init__(self, *computers: str) -> None:
        super().__init__(*computers)
        self.ends: dict[str, ActionEnd] = {}
        self.requests: dict[str, tuple[TaskRequest, ...]] = {}
        self.crashing = ""
        self.crashes = 0
        self.lost_amid_activation = ""
        self.lag = 0  # how many deployments their last reports are behind

    def say(self, component: str, *, done: bool = True) -> None:
        before = self.ends.get(component)
        count = before.count + 1 if before else 1
        self.ends[component] = ActionEnd(port="done", count=count, done=done)

    def configure(self, component: str) -> None:
        """Let one that stayed behind do what it was told."""
        del self.states[component]
        for status in self.statuses().values():
            for container in status.containers:
                for each in container.components:
                    if each.name == component:
                        done = replace(each, state="inactive")
                        self.report_component(status.computer, done)

    def wait_news(self, is_enough: Callable[[], bool], limit: float) -> bool:
        if limit == ACTIVE_LIMIT and self.lost_amid_activation:
            is_enough()
            self.gone.add(self.lost_amid_activation)
        self.lag = 0
        return any(super(Speaking, self).wait_news(is_enough, limit) for _ in range(5))

    def statuses(self) -> dict[str, AgentStatus]:
        return {name: self._said(each) for name, each in super().statuses().items()}

    def _said(self, status: AgentStatus) -> AgentStatus:
        status = replace(status, generation=status.generation - self.lag)
        for container in status.containers:
            if self.crashing in [each.name for each in container.components]:
                self.crashes += 1
                return self._crashed(status, container)
        containers = tuple(
            replace(c, components=tuple(map(self._with_ends, c.components)))
            for c in status.containers
        )
        return replace(status, containers=containers)

    def _crashed(self, status: AgentStatus, gone: ContainerStatus) -> AgentStatus:
        """Return what is known once a container has crashed again as it started."""
        fault = Fault(container=gone.name, message="was killed by SIGSEGV")
        faults = [replace(fault, number=n + 1) for n in range(self.crashes)]
        containers = tuple(each for each in status.containers if each is not gone)
        return replace(status, containers=containers, faults=tuple(faults))

    def _with_ends(self, component: ComponentStatus) -> ComponentStatus:
        end = self.ends.get(component.name)
        requests = self.requests.get(component.name, ())
        return replace(component, ends=(end,) if end else (), task_requests=requests)


class Rig:
    """A run whose first tasks are started."""

    def __init__(self, robot: Robot, *started: str, saved: Saved | None = None) -> None:
        self.robot = robot
        self.agents = Speaking("main", "spare")
        self.loads: dict[str, Load] = {}
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(robot, {}, agents, self.journal, "/run")
        self.run.start()
        self.manager = TaskManager(self.run, saved or Saved(), self._situation)
        for name in started:
            self.manager.command("start", name)
        self.manager.advance()

    def _situation(self) -> Situation:
        return Situation(
            robot=replace(self.robot, tasks=self.manager.now()),
            placement=self.run.placement(),
            lost=frozenset(self.agents.gone),
            loads=self.loads,
        )

    def end(self, component: str, *, done: bool = True) -> None:
        self.agents.say(component, done=done)
        assert self.manager.has_news()
        self.manager.advance()

    def active(self) -> set[str]:
        return set(self.run.placed)

    def resting(self) -> set[str]:
        return set(self.run.prefetched)

    def states(self) -> dict[str, tuple[str, str]]:
        return {each.name: (each.state, each.why) for each in self.manager.reports}

    def said(self) -> list[str]:
        return [each.what for each in self.journal.entries()]


def test_an_action_ends_by_its_component_and_the_next_one_starts() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go", "see"))), "t")
    assert rig.active() == {"seeer"}
    rig.end("seeer")
    assert rig.active() == {"seeer", "goer"}
    rig.end("goer")
    assert (rig.active(), rig.resting()) == (set(), {"seeer", "goer"})
    assert rig.states() == {"t": ("done", "")}


def test_an_action_fails_at_once_when_an_alternative_lacks_what_ends_it(
    tmp_path: Path,
) -> None:
    """A better alternative provides `see` without the component that reports the end.

    No architecture is to blame, so nothing is learned of any.
    """
    robot = robot_with(task("t", act("a", "see", "go", limit=60.0)))
    better = Architecture(
        name="quick-see",
        function="see",
        components=(
            ComponentEntry(
                name="glancer",
                implementation="a:B",
                demand={"cpu": 0.1},
                only=("main",),
            ),
        ),
    )
    see, *others = robot.architectures
    architectures = (replace(see, quality=0.5), *others, better)
    robot = replace(robot, architectures=architectures, folder=str(tmp_path))
    rig = Rig(robot, "t")
    state, why = rig.states()["t"]
    assert state == "failed"
    assert why == (
        "action 'a' failed: 'seeer.done' ends it, but architecture 'quick-see' "
        "provides 'see' without component 'seeer'"
    )
    for architecture in ("quick-see", "go-arch"):
        assert beliefs_about(robot, architecture) == []


def test_a_component_learns_once_that_its_action_begins() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "see"))), "t")
    first = rig.run.placed["seeer"]
    assert [*first.actions.values()] == ["a"]
    rig.manager.advance()
    assert rig.run.placed["seeer"] == first
    rig.end("seeer")
    second = rig.run.placed["seeer"]
    assert [*second.actions.values()] == ["b"]
    assert (second.epoch, first.actions.keys() & second.actions) == (first.epoch, set())


def test_a_component_learns_of_all_actions_that_begin_at_once() -> None:
    tasks = task("t", act("a", "see")), task("u", act("b", "see"))
    rig = Rig(robot_with(*tasks), "t", "u")
    assert [*rig.run.placed["seeer"].actions.values()] == ["a", "b"]


def test_one_that_moves_goes_on_with_its_action() -> None:
    robot = robot_with(task("t", act("a", "see")))
    (see, *others) = robot.architectures
    (component,) = see.components
    see = replace(see, components=(replace(component, only=()),))
    rig = Rig(replace(robot, architectures=(see, *others)), "t")
    rig.manager.advance()
    plan_move(rig.run, "seeer", "spare").configure_ahead()
    (target,) = rig.run.desired.configured_ahead
    assert target.actions == rig.run.placed["seeer"].actions != {}


def test_one_that_was_restarted_by_others_learns_its_action_again() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"))), "t")
    placed = rig.run.placed["seeer"]
    again = replace(placed, epoch=9, actions={})
    rig.run.commit(rig.run.desired.placing([again]), "it was restarted")
    rig.manager.advance()
    assert rig.run.placed["seeer"].actions == placed.actions


def test_what_may_come_next_is_told_at_once() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))))
    rig.manager.command("start", "t")
    assert rig.manager.report("t").next == ("b",)
    rig.manager.command("cancel", "t")
    assert rig.manager.report("t").next == ()


def test_what_no_action_needs_ends_after_its_linger() -> None:
    robot = robot_with(task("t", act("a", "see"), act("b", "go")), linger=0.0)
    rig = Rig(robot, "t")
    rig.end("seeer")
    rig.manager.advance()
    assert rig.resting() == set()
    assert (
        "stopping architecture 'see-arch': no action has needed it for 0.0 s"
        in rig.said()
    )


def test_the_task_of_higher_priority_gets_the_room_and_the_other_goes_on_later() -> (
    None
):
    low = task("low", act("a", "see", "go"))
    rig = Rig(robot_with(low, task("high", act("b", "say"), priority=5)), "low")
    before = rig.run.placed["goer"].epoch
    rig.manager.command("start", "high")
    assert rig.active() == {"sayer"}
    assert rig.resting() == {"seeer", "goer"}
    state, why = rig.states()["low"]
    assert state == "waiting"
    assert why.startswith("task 'high' uses capacity that this one needs: ")
    rig.end("sayer")
    assert rig.active() == {"seeer", "goer"}
    assert rig.run.placed["goer"].epoch == before  # it kept its state
    assert rig.states()["low"] == ("going", "")


def test_a_task_that_finds_no_room_waits_for_the_one_that_is_at_work() -> None:
    first = task("first", act("a", "see", "go"))
    rig = Rig(robot_with(first, task("second", act("b", "say"))), "first", "second")
    assert rig.active() == {"seeer", "goer"}
    assert rig.states()["second"][0] == "waiting"
    report = rig.manager.report("second")  # what it waits to begin does not come next
    assert ([each.name for each in report.actions], report.next) == (["b"], ())
    said = len(rig.said())
    for _ in range(3):
        rig.manager.advance()
    assert len(rig.said()) == said  # it says so once
    rig.manager.command("cancel", "first")
    assert rig.active() == {"sayer"}


def test_a_task_goes_on_when_other_programs_leave_another_one_no_room() -> None:
    tasks = task("first", act("a", "see")), task("second", act("b", "say"))
    rig = Rig(robot_with(*tasks), "first")
    rig.loads["main"] = Load(capacity=1.0, used=1.0, background=0.9)
    rig.manager.command("start", "second")
    assert rig.active() == {"seeer"}
    assert rig.states()["first"][0] == "going"
    state, why = rig.states()["second"]
    assert state == "waiting"
    assert why.endswith("Other programs take 0.9 cores of 'main'")
    rig.loads.clear()
    rig.manager.command("cancel", "first")
    assert rig.active() == {"sayer"}


def test_room_is_looked_for_again_soon_after_a_computer_was_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before that it was looked for less and less often, once a minute in the end."""
    now, looks = 0.0, list[float]()
    monkeypatch.setattr(task_manager, "boot_time", lambda: now)
    rig = Rig(robot_with(task("t", act("a", "see"))), "t")
    monkeypatch.setattr(rig.manager.tasks, "unblock", lambda: looks.append(now))
    for _ in range(300):
        now += 1.0
        rig.manager.advance()
    rig.agents.gone.add("spare")
    looks.clear()
    for _ in range(8):
        now += 1.0
        rig.manager.advance()
    assert looks == [301.0, 303.0, 307.0]


def test_an_action_that_does_not_fit_alone_fails_and_says_why() -> None:
    other = act("a", "see", "go", on_failure=act("b", "say"))
    rig = Rig(robot_with(task("t", other), cpu=0.5), "t")
    assert rig.active() == {"sayer"}
    assert any("has failed: it does not fit: " in each for each in rig.said())


def test_what_is_resumed_waits_for_room_that_other_programs_take_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig(robot_with(task("t", act("a", "see", on_failure=act("b", "go")))), "t")
    rig.manager.command("pause", "t")
    rig.loads["main"] = Load(capacity=1.0, used=0.9, background=0.9)
    rig.manager.command("resume", "t")
    state, why = rig.states()["t"]
    assert (state, rig.active()) == ("waiting", set())
    assert why.startswith("it does not fit any more: ")
    assert why.endswith("Other programs take 0.9 cores of 'main'")
    rig.loads.clear()
    later = boot_time() + 60
    monkeypatch.setattr(task_manager, "boot_time", lambda: later)
    rig.manager.advance()
    assert (rig.states()["t"], rig.active()) == (("going", ""), {"seeer"})


def test_what_is_suspended_needs_no_room_and_holds_no_action_up() -> None:
    rig = Rig(robot_with(task("t", act("a", "see", "go")), cpu=0.5))
    rig.manager.tasks.start("t", 0.0)
    rig.manager.advance(suspended={"go"})
    assert rig.active() == {"seeer"}
    assert rig.states()["t"] == ("going", "")
    (report,) = rig.manager.reports
    assert [each.is_at_work for each in report.actions] == [True]


def test_an_action_that_does_not_fit_is_not_begun_again_at_once() -> None:
    """All its retries were used up within a moment in which nothing changed."""
    other = act("a", "see", "go", on_failure=Retry(times=3, then=act("b", "say")))
    rig = Rig(robot_with(task("t", other), cpu=0.5), "t")
    assert rig.active() == {"sayer"}
    assert sum("it does not fit: " in each for each in rig.said()) == 1


def test_an_action_that_begins_again_takes_the_alternative_of_what_was_lost(
    tmp_path: Path,
) -> None:
    """It said that it begins, and nothing provided its function."""
    look = Action(name="a", functions=("see",), on_failure=Retry(times=2))
    robot = robot_with(task("t", look))
    see, *others = robot.architectures
    (seer,) = see.components
    other = replace(
        see, name="other", quality=0.5, components=(replace(seer, name="other"),)
    )
    seer = replace(seer, only=("spare",), demand={"cpu": 0.05})
    see = replace(see, components=(seer,))
    robot = replace(robot, architectures=(see, other, *others), folder=str(tmp_path))
    rig = Rig(robot, "t")
    assert rig.active() == {"seeer"}
    rig.agents.gone.add("spare")
    rig.run.goes_on_without_lost = True
    rig.manager.advance()
    assert rig.active() == {"seeer"}  # it may be at work there
    (each,) = rig.manager.tasks.tries(rig.manager.tasks.find("t"))
    rig.manager.tasks.end(each.number, 0.0, "it saw nothing", done=False)
    rig.manager.advance()
    assert rig.active() == {"other"}


def test_an_action_whose_component_does_not_start_fails_and_says_why() -> None:
    rig = Rig(robot_with(task("t", act("a", "go", on_failure=act("b", "see")))))
    error = "Traceback\nValueError: no motor"
    rig.agents.states["goer"] = ComponentStatus(
        name="goer", state="failed", error=error
    )
    rig.manager.command("start", "t")
    rig.manager.advance()  # the next look
    assert rig.active() == {"seeer"}
    assert any(error in each for each in rig.said())
    assert any("has failed: it cannot begin: component 'goer'" in e for e in rig.said())


def test_an_action_whose_component_does_not_start_again_fails_and_no_other() -> None:
    """It is at work; that its component is missing is seen when another begins."""
    walks = Sequence(steps=(act("walk", "go"), act("stroll", "go")))
    look = act("look", "see", on_failure=act("listen", "say"))
    rig = Rig(robot_with(task("t", Parallel(steps=(look, walks)))), "t")
    rig.run.commit(rig.run.desired.without(["seeer"]), "it could not be started")
    rig.agents.crashing = "seeer"
    rig.end("goer")
    assert sum("an action cannot begin" in each for each in rig.said()) == 1
    assert any("has failed: it cannot go on: comp" in each for each in rig.said())
    rig.manager.advance()  # the next look
    assert rig.active() == {"goer", "sayer"}


def test_what_takes_long_to_be_configured_holds_nothing_else_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps = act("a", "see"), act("b", "say")
    rig = Rig(robot_with(task("t", *steps), task("u", act("c", "go")), cpu=2.0), "t")
    slow = ComponentStatus(name="goer", state="unconfigured")
    rig.agents.states["goer"] = slow
    rig.manager.command("start", "u")
    rig.end("seeer")
    assert rig.active() == {"sayer"}
    assert not rig.manager.has_news()
    now = rig.manager.now()
    assert replace(rig.robot, tasks=now).functions_of() == ("say",)
    (begun,) = rig.run.desired.configured_ahead
    rig.agents.configure("goer")
    assert rig.manager.has_news()
    rig.manager.advance()
    assert rig.active() == {"sayer", "goer"}
    assert rig.run.placed["goer"].key == begun.key

    rig.end("goer")
    rig.agents.states["goer"] = slow
    rig.run.commit(rig.run.desired.without(["goer"]), "it was idle for long")
    rig.manager.command("start", "u")
    rig.manager.command("pause", "u")
    assert not rig.run.desired.configured_ahead
    rig.manager.command("resume", "u")
    monkeypatch.setattr("poise.manage.tasks.switch.READY_LIMIT", -1.0)
    rig.manager.advance()
    state, why = rig.states()["u"]
    assert state == "failed"
    assert "it cannot begin: not ready within -1 s: component 'goer'" in why


def test_what_is_configured_for_a_task_that_is_cancelled_ends_and_no_other() -> None:
    tasks = task("t", act("a", "see")), task("u", act("b", "go"))
    rig = Rig(robot_with(*tasks))
    for name in ("seeer", "goer"):
        rig.agents.states[name] = ComponentStatus(name=name, state="unconfigured")
    for each in tasks:
        rig.manager.command("start", each.name)
    rig.manager.command("cancel", "t")
    assert [e.component for e in rig.run.desired.configured_ahead] == ["goer"]
    assert not rig.manager.is_over()
    rig.manager.command("cancel", "u")
    assert not rig.run.desired.configured_ahead
    assert rig.manager.is_over()


def test_what_fails_as_its_action_ends_is_no_failure_of_the_next_one() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))), "t")
    rig.agents.states["seeer"] = ComponentStatus(
        name="seeer", state="failed", error="Traceback\nValueError: no rest"
    )
    rig.end("seeer")
    assert rig.active() == {"goer"}
    rig.manager.advance()
    assert rig.resting() == set()
    assert (
        "component 'seeer' on 'main' failed when its action ended, and lost its state: "
        "ValueError: no rest"
    ) in rig.said()


def test_what_does_not_come_to_rest_is_waited_for_by_what_begins_alone() -> None:
    robot = robot_with(task("t", act("a", "see"), act("b", "go")), task("u"), cpu=2.0)
    rig = Rig(replace(robot, tasks=(*robot.tasks[:1], task("u", act("c", "say")))))
    for name in "tu":
        rig.manager.command("start", name)
    rig.agents.states["seeer"] = ComponentStatus(name="seeer", state="active")
    rig.end("seeer")
    rig.end("sayer")
    assert rig.states()["u"] == ("done", "")
    assert rig.active() == set()
    assert [each.component for each in rig.run.coming_to_rest()] == ["seeer"]
    rig.agents.configure("seeer")
    rig.manager.advance()
    assert rig.active() == {"goer"}


def test_a_computer_that_is_lost_comes_before_what_takes_long_to_be_activated() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"))))
    rig.run.goes_on_without_lost = True
    rig.agents.lost_amid_activation = "spare"
    rig.agents.states["seeer"] = ComponentStatus(name="seeer", state="inactive")
    rig.manager.command("start", "t")
    assert rig.states()["t"] == ("going", "")
    assert rig.active() == set()
    assert [e.component for e in rig.run.desired.configured_ahead] == ["seeer"]
    rig.manager.advance()  # at once: what was lost is started elsewhere first
    assert rig.active() == set()


def test_what_does_not_start_is_tried_once_a_look() -> None:
    """Each try may take long, and the robot is looked after in between."""
    again = Retry(times=2)
    rig = Rig(robot_with(task("t", act("a", "go", on_failure=again))))
    rig.agents.crashing = "goer"
    rig.manager.command("start", "t")
    for tries in (1, 2, 3, 3):
        said = [each for each in rig.said() if "an action cannot begin" in each]
        assert len(said) == tries
        rig.manager.advance()
    assert rig.states()["t"][0] == "failed"


@pytest.mark.parametrize(
    ("name", "then"), [("main", "seeer"), ("spare", "goer"), ("", "goer")]
)
def test_a_condition_ends_an_action_where_its_subject_or_any_is_so(
    name: str, then: str
) -> None:
    """All that runs is on the one computer, nothing on the other."""
    until = Until(when="components == 0", subject="computer", name=name)
    rig = Rig(robot_with(task("t", act("a", "see", until=until), act("b", "go"))), "t")
    rig.manager.advance()
    assert rig.active() == {then}


def test_what_never_stops_is_needed_beside_all_actions() -> None:
    robot = robot_with(task("t", act("a", "see")))
    fixed = replace(robot.architectures[1], layer="reactive")
    rig = Rig(replace(robot, architectures=(*robot.architectures[:1], fixed)), "t")
    assert replace(robot, tasks=rig.manager.now()).functions_of() == ("see",)
    rig.run.commit(rig.run.desired.placing([rig.run.begun("goer", "main")]), "a test")
    assert replace(robot, tasks=rig.manager.now()).functions_of() == ("see", "go")


def test_what_is_done_on_failure_is_not_needed_before() -> None:
    robot = robot_with(task("t", act("a", "see", on_failure=act("b", "go"))))
    rig = Rig(robot, "t")
    now = rig.manager.now()
    assert replace(robot, tasks=now).functions_of() == ("see",)
    rig.end("seeer", done=False)
    now = rig.manager.now()
    assert replace(robot, tasks=now).functions_of() == ("go",)


def test_what_rests_gives_way_when_its_memory_is_needed() -> None:
    steps = act("a", "see"), act("b", "go"), act("c", "say")
    rig = Rig(robot_with(task("t", *steps), memory=7e8), "t")
    rig.end("seeer")
    assert rig.resting() == {"seeer"}
    rig.end("goer")
    assert (rig.active(), rig.resting()) == ({"sayer"}, {"goer"})
    assert "there is not enough memory to keep seeer idle" in rig.said()


@pytest.mark.parametrize(("memory", "resting"), [(8e8, set()), (9e8, {"seeer"})])
def test_what_ends_rests_where_memory_is_left_beside_what_is_at_work(
    memory: float, resting: set[str]
) -> None:
    tasks = task("t", act("a", "see"), act("b", "go")), task("u", act("c", "say"))
    rig = Rig(robot_with(*tasks, cpu=2.0, memory=memory), "t", "u")
    rig.end("seeer")
    assert (rig.active(), rig.resting()) == ({"goer", "sayer"}, resting)


def test_a_paused_task_rests_and_keeps_its_state() -> None:
    rig = Rig(robot_with(task("t", act("a", "see")), linger=0.0), "t")
    before = rig.run.placed["seeer"]
    rig.manager.command("pause", "t")
    rig.manager.advance()
    assert (rig.active(), rig.resting()) == (set(), {"seeer"})
    rig.manager.command("resume", "t")
    assert rig.run.placed["seeer"].key == before.key


def test_agents_learn_what_rests_together_with_how_far_its_task_is() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))), "t")
    rig.agents.deployed.clear()
    rig.end("seeer")
    rig.manager.command("pause", "t")
    for _, deployment in rig.agents.deployed:
        record = msgspec.msgpack.decode(deployment.desired, type=Desired)
        saved = msgspec.msgpack.decode(record.tasks, type=Saved)
        (attempt,) = Tasks(rig.robot, saved=saved).tries(saved.records[0])
        active = [each.name for each in deployment.components if each.goal == "active"]
        if attempt.is_at_work and deployment.components:  # none is on the other one
            assert active == [f"{attempt.action.functions[0]}er"]


def with_lesser(robot: Robot) -> Robot:
    """Return it with an alternative of `see` that the planner would not take."""
    lesser = Architecture(
        name="lesser",
        function="see",
        quality=0.5,
        components=(ComponentEntry(name="glancer", demand={"cpu": 0.1}),),
    )
    return replace(robot, architectures=(*robot.architectures, lesser))


def test_an_alternative_takes_the_place_of_what_leaves_no_room() -> None:
    actions = act("a", "see"), act("b", "go", "see", "say")
    rig = Rig(with_lesser(robot_with(task("t", *actions))), "t")
    assert rig.active() == {"seeer"}
    rig.end("seeer")
    assert rig.states() == {"t": ("going", "")}
    assert rig.active() == {"goer", "sayer", "glancer"}
    assert rig.resting() == {"seeer"}
    assert any("takes the place of 'see-arch': " in said for said in rig.said())


def test_an_alternative_begins_instead_of_what_may_be_at_work_out_of_reach() -> None:
    actions = act("a", "see"), act("b", "go"), Action(name="c", functions=("see",))
    robot = with_lesser(robot_with(task("t", *actions))).with_components(
        lambda c: replace(c, only=()) if c.name == "seeer" else c
    )
    rig = Rig(robot, "t")
    rig.run.goes_on_without_lost = True
    epoch = rig.run.next_epoch("seeer")
    moved = replace(rig.run.placed["seeer"], computer="spare", epoch=epoch)
    rig.run.commit(rig.run.desired.placing([moved]), "it moved")
    for where in (rig.agents.gone, rig.agents.heard, rig.agents.lasting_leases):
        where.add("spare")
    rig.end("seeer")
    rig.end("goer")
    assert rig.states() == {"t": ("going", "")}
    assert rig.active() == {"glancer"}


def test_no_alternative_takes_the_place_of_what_another_action_uses() -> None:
    more = act("b", "go", "say")
    tasks = task("t", act("a", "see")), task("u", more)
    rig = Rig(with_lesser(robot_with(*tasks)), "t", "u")
    assert rig.active() == {"seeer"}
    assert rig.states()["u"][0] == "waiting"


def after_replace() -> Rig:
    """Return two actions that see, amid the first, after `poise replace`."""
    actions = (Action(name=name, functions=("see",)) for name in "ab")
    rig = Rig(with_lesser(robot_with(task("t", *actions))), "t")
    assert rig.active() == {"seeer"}
    replaced = rig.run.begun("glancer", "main")
    desired = rig.run.desired.without(["seeer"]).placing([replaced])
    rig.run.commit(desired, "it was replaced")
    rig.manager.advance()
    return rig


def paused_after_replace() -> Rig:
    rig = after_replace()
    rig.manager.command("pause", "t")
    rig.manager.advance()
    assert (rig.active(), rig.resting()) == (set(), {"glancer"})
    return rig


def test_nothing_is_likely_where_another_alternative_goes_on() -> None:
    assert after_replace().manager.likely_next() == []


def test_a_paused_task_goes_on_with_the_alternative_that_has_its_state() -> None:
    rig = paused_after_replace()
    resting = rig.run.prefetched["glancer"]
    prepare(rig.run, {"seeer": "main"}, {})  # it has no state
    idle = replace(rig.run.prefetched["seeer"], gently=False)
    rig.run.commit(rig.run.desired.with_prefetched([idle]), "no action is likely")
    rig.manager.command("resume", "t")
    assert rig.run.placed["glancer"].key == resting.key
    assert rig.active() == {"glancer"}


def test_of_alternatives_that_rest_the_one_that_worked_last_goes_on() -> None:
    actions = act("a", "see"), act("b", "go", "see")
    rig = Rig(with_lesser(robot_with(task("t", *actions))), "t")
    rig.loads["main"] = Load(capacity=1.0, used=0.5, background=0.5)
    rig.end("seeer")
    rig.manager.command("pause", "t")
    assert (rig.active(), rig.resting()) == (set(), {"seeer", "goer", "glancer"})
    resting = rig.run.prefetched["glancer"]
    rig.loads.clear()
    rig.manager.command("resume", "t")
    assert rig.active() == {"goer", "glancer"}
    assert rig.run.placed["glancer"].key == resting.key


def test_an_alternative_that_has_the_state_does_not_lose_it_when_it_takes_long() -> (
    None
):
    rig = paused_after_replace()
    resting = rig.run.prefetched["glancer"]
    rig.run.goes_on_without_lost = True
    rig.agents.lost_amid_activation = "spare"
    rig.agents.states["glancer"] = ComponentStatus(name="glancer", state="inactive")
    rig.manager.command("resume", "t")
    rig.manager.advance()
    assert [e.key for e in rig.run.desired.configured_ahead] == [resting.key]


def test_components_start_tasks_and_refusals_are_journalled() -> None:
    rig = Rig(robot_with(task("t", act("a", "see")), task("u", act("b", "go"))), "t")
    requests = [("start", "u"), ("start", "nap"), ("pause", "t")]
    rig.agents.requests["seeer"] = tuple(
        TaskRequest(number=n, verb=verb, task=name)  # type: ignore[arg-type] # of a test
        for n, (verb, name) in enumerate(requests, 1)
    )
    for _ in range(2):
        rig.manager.advance()
    assert rig.states() == {"t": ("paused", "on request"), "u": ("going", "")}
    (refused,) = (each for each in rig.said() if "has no task 'nap'" in each)
    assert refused.startswith("component 'seeer' asks to start task 'nap': ")


def test_the_next_manager_hears_no_request_again() -> None:
    rig = Rig(robot_with(task("t", act("a", "see")), task("u", act("b", "go"))), "t")
    request = TaskRequest(number=1, verb="start", task="u")
    rig.agents.requests["seeer"] = (request,)
    rig.manager.advance()
    rig.end("goer")
    saved = msgspec.msgpack.decode(rig.run.desired.tasks, type=Saved)
    TaskManager(rig.run, saved, rig._situation).advance()
    assert [(r.name, r.state) for r in saved.records] == [("t", "going"), ("u", "done")]


def test_what_a_component_said_before_a_move_counts_once() -> None:
    actions = act("a", "see"), act("b", "see"), act("c", "go")
    rig = Rig(robot_with(task("t", *actions), task("u", act("d", "say"))), "t")
    rig.agents.say("seeer")
    rig.agents.requests["seeer"] = (TaskRequest(number=1, verb="start", task="u"),)
    for _ in range(2):
        moved = replace(rig.run.placed["seeer"], epoch=rig.run.next_epoch("seeer"))
        rig.run.commit(rig.run.desired.placing([moved]), "it moved")
        rig.manager.advance()
    assert rig.active() == {"seeer", "sayer"}
    assert [each.actions[0].name for each in rig.manager.reports] == ["b", "d"]
    assert sum("asks to start task 'u'" in each for each in rig.said()) == 1


def test_what_a_component_says_after_a_restart_is_heard() -> None:
    actions = act("a", "see"), act("b", "see"), act("c", "go")
    rig = Rig(robot_with(task("t", *actions), task("u", act("d", "say"))), "t")
    for number in (8, 4):  # one that starts again begins anywhere
        rig.agents.ends["seeer"] = ActionEnd(port="done", count=number, done=True)
        request = TaskRequest(number=number, verb="start", task="u")
        rig.agents.requests["seeer"] = (request,)
        rig.manager.advance()
        assert rig.states()["u"] == ("going", "")
        rig.manager.command("cancel", "u")
    assert rig.active() == {"goer"}


def test_an_end_that_is_said_while_its_task_is_being_paused_counts() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))), "t")
    rig.agents.say("seeer")
    for verb in ("pause", "resume"):
        rig.manager.command(verb, "t")
        rig.manager.advance()
    assert rig.active() == {"goer"}


def test_what_ended_an_action_ends_no_later_one_when_agents_report_late() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"))), "t")
    rig.end("seeer")
    rig.agents.lag = 1
    rig.manager.command("start", "t")
    rig.manager.advance()
    assert rig.states()["t"] == ("going", "")


def test_what_another_action_was_told_to_end_says_nothing_of_a_paused_one() -> None:
    rig = Rig(robot_with(task("t", act("a", "see")), task("u", act("b", "see"))), "t")
    rig.manager.command("start", "u")
    rig.manager.command("pause", "t")
    rig.end("seeer")
    rig.manager.command("resume", "t")
    rig.manager.advance()
    assert rig.states()["t"] == ("going", "")


def test_what_is_on_a_lost_computer_holds_no_switch_up() -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))), "t")
    away = replace(rig.run.placed["seeer"], computer="spare")
    rig.agents.gone.add("spare")
    rig.run.goes_on_without_lost = True
    rig.run.commit(rig.run.desired.placing([away]), "it was there")
    (each,) = rig.manager.tasks.tries(rig.manager.tasks.find("t"))
    rig.manager.tasks.end(each.number, 0.0, "told", done=True)
    rig.manager.advance()
    assert (rig.active(), rig.resting()) == ({"goer"}, set())


def test_the_next_manager_goes_on_where_this_one_was() -> None:
    robot = robot_with(
        task("t", act("a", "see"), act("b", "go")), task("u", act("c", "say"))
    )
    rig = Rig(robot, "t")
    rig.end("seeer")
    kept = Desired(tasks=rig.run.desired.tasks, ended=rig.run.desired.ended)
    assert {told.desired for _, told in rig.agents.deployed[-2:]} == {
        msgspec.msgpack.encode(kept)
    }
    asked = Tasks(robot)
    asked.start("t", 0.0)
    asked.start("u", 0.0)
    rig.run.has_taken_over = True
    saved = goes_on_with(rig.run, asked, rig.journal)
    assert "task 't' goes on with 'b'" in rig.said()
    states = [(each.name, each.state) for each in saved.records]
    assert states == [("t", "going"), ("u", "going")]
    again = Rig(robot, saved=msgspec.convert(msgspec.to_builtins(saved), Saved))
    assert again.active() == {"goer", "sayer"}


def test_the_limit_of_an_action_holds_though_the_time_of_day_steps_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limited = replace(act("a", "see"), limit=60.0)
    rig = Rig(robot_with(task("t", limited)), "t")
    then = time.time()
    monkeypatch.setattr(time, "time", lambda: then - 10 * 365 * 86400.0)
    (each,) = rig.manager.tasks.tries(rig.manager.tasks.records[0])
    assert each.progress.since is not None
    each.progress.since -= 61
    rig.manager.advance()
    assert rig.states()["t"][0] == "failed"


@pytest.mark.parametrize("boot", ["this", "another"])
def test_the_limit_of_an_action_goes_on_under_the_next_manager(boot: str) -> None:
    limited = replace(act("a", "see"), limit=60.0)
    rig = Rig(robot_with(task("t", limited)), "t")
    (each,) = rig.manager.tasks.tries(rig.manager.tasks.records[0])
    assert each.progress.since is not None
    each.progress.since -= 50
    rig.manager.tasks.saved.boot = boot_id() if boot == "this" else boot
    kept = msgspec.msgpack.encode(rig.manager.tasks.saved)
    rig.run.commit(replace(rig.run.desired, tasks=kept), "kept")
    rig.run.has_taken_over = True
    saved = goes_on_with(rig.run, Tasks(rig.robot), rig.journal)
    tasks = Tasks(rig.robot, saved=saved)
    (again,) = tasks.tries(tasks.records[0])
    left = 60 - tasks.worked(again, each.progress.since + 50)
    assert left == pytest.approx(10 if boot == "this" else 60, abs=5)
    said = [what for what in rig.said() if "the limit of 60 s of action" in what]
    assert len(said) == (boot == "another")


def test_tasks_of_another_version_are_dropped_and_what_was_asked_for_begins() -> None:
    rig = Rig(robot_with(task("t", act("a", "see")), task("u", act("b", "go"))), "t")
    rig.agents.requests["seeer"] = (TaskRequest(number=1, verb="pause", task="u"),)
    rig.manager.advance()
    saved = msgspec.to_builtins(rig.manager.tasks.saved)
    saved["records"][0]["progress"]["inside"][0]["heard"] = [1, 2]
    kept = msgspec.msgpack.encode(saved)
    rig.run.commit(replace(rig.run.desired, tasks=kept), "kept")
    rig.run.has_taken_over = True
    asked = Tasks(rig.robot)
    asked.start("u", 0.0)
    assert goes_on_with(rig.run, asked, rig.journal) is asked.saved
    assert asked.saved.heard == {"seeer": {0: 1}}
    why = "Expected `int`, got `array` - at `$.records[0].progress.inside[0].heard`"
    said = f"the previous manager's tasks cannot be read, and are dropped: {why}"
    assert said in rig.said()


def test_a_choice_that_is_ahead_is_said_only_when_it_is_made() -> None:
    choice = Choice(steps=(act("a", "see"), act("b", "go")))
    rig = Rig(robot_with(task("t", act("first", "see"), choice)), "t")
    rig.manager.likely_next()
    rig.manager.advance()
    (report,) = rig.manager.reports
    assert report.next == ("a",)
    assert "choice of" not in rig.said()


def test_what_could_not_begin_is_no_failure_of_what_serves_it(tmp_path: Path) -> None:
    steps = act("a", "see"), act("b", "see", "go", "say")
    robot = replace(robot_with(task("t", *steps)), folder=str(tmp_path))
    rig = Rig(robot, "t")
    rig.end("seeer")
    assert "action 'b' failed: it does not fit" in rig.states()["t"][1]
    assert [belief.action for belief in beliefs_about(robot, "see-arch")] == ["a"]


def test_what_does_not_start_is_a_failure_of_its_architecture(tmp_path: Path) -> None:
    failing = act("a", "see", "go", on_failure=act("b", "see"))
    robot = replace(robot_with(task("t", failing)), folder=str(tmp_path))
    rig = Rig(robot)
    rig.agents.states["goer"] = ComponentStatus(name="goer", state="failed", error="E")
    rig.manager.command("start", "t")
    (belief,) = beliefs_about(robot, "go-arch")
    assert (belief.action, belief.failed) == ("a", 1)
    assert beliefs_about(robot, "see-arch") == []


def test_what_crashes_as_it_starts_is_a_failure_of_its_architecture(
    tmp_path: Path,
) -> None:
    failing = act("a", "go", on_failure=act("b", "say"))
    robot = replace(robot_with(task("t", failing)), folder=str(tmp_path))
    rig = Rig(robot)
    rig.agents.crashing = "goer"
    rig.manager.command("start", "t")
    said = "container 'go-arch' on 'main' was killed by SIGSEGV ("
    assert any(said in each for each in rig.said())
    rig.manager.advance()  # the next look
    assert rig.active() == {"sayer"}
    (belief,) = beliefs_about(robot, "go-arch")
    assert (belief.action, belief.failed) == ("a", 1)


@pytest.mark.parametrize(
    "steps", [(act("a", "see"),), (act("a", "see"), Parallel(steps=(act("b", "go"),)))]
)
def test_a_task_whose_steps_are_others_now_is_dropped(steps: tuple[Step, ...]) -> None:
    rig = Rig(robot_with(task("t", act("a", "see"), act("b", "go"))), "t")
    rig.end("seeer")
    saved = msgspec.msgpack.decode(rig.run.desired.tasks, type=Saved)
    said: list[str] = []
    tasks = Tasks(robot_with(task("t", *steps)), said.append, saved=saved)
    text = "task 't' is dropped: the robot file no longer has these steps"
    assert (tasks.records, said) == ([], [text])


@pytest.mark.parametrize(
    ("done", "then", "said"),
    [
        (False, "goer", "chose 'b'; expected: 'a' 33%, 'b' 50%"),
        (True, "seeer", "chose 'a'; expected: 'a' 67%, 'b' 50%"),
    ],
)
def test_how_actions_end_is_learned_and_decides_choices(
    tmp_path: Path, *, done: bool, then: str, said: str
) -> None:
    """Of 1 outcome; the other step was not tried, and no function has alternatives."""
    choice = Choice(steps=(act("a", "see"), act("b", "go")))
    robot = replace(robot_with(task("t", choice)), folder=str(tmp_path))
    rig = Rig(robot, "t")
    assert rig.active() == {"seeer"}
    assert "chose 'a'; expected: 'a' 100%, 'b' 100%" in rig.said()
    rig.end("seeer", done=done)
    (belief,) = beliefs_about(robot, "see-arch")
    assert (belief.action, belief.done, belief.failed) == ("a", done, not done)
    rig.manager.command("start", "t")
    assert rig.active() == {then}
    assert said in rig.said()


def test_what_a_choice_will_be_is_found_out_once_until_something_is_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def outcomes(robot: Robot, function: str) -> Any:
        asked.append(function)
        return outcomes_of(robot, function)

    monkeypatch.setattr(success_rates, "outcomes_of", outcomes)
    choice = Choice(steps=(act("b", "go"), act("c", "say")))
    tasks = task("t", act("a", "see"), choice), task("u", act("d", "say"))
    robot = replace(robot_with(*tasks), folder=str(tmp_path))
    rig = Rig(robot, "t", "u")
    for _ in range(3):
        rig.manager.advance()
    assert asked == ["go", "say"]
    rig.end("sayer")
    rig.manager.advance()
    assert asked == 2 * ["go", "say"]
    rig.end("seeer")
    assert rig.active() == {"goer"}
    assert asked == 3 * ["go", "say"]


@pytest.mark.parametrize("verb", ["pause", "resume", "cancel"])
def test_a_command_to_a_task_that_does_not_run_is_refused(verb: str) -> None:
    rig = Rig(robot_with(task("t", act("a", "see"))))
    with pytest.raises(UsageError, match="task 't' does not run"):
        rig.manager.command(verb, "t")
