"""What a manager says while it carries out a command."""

from __future__ import annotations

from typing import cast

import pytest
from msgspec.structs import replace

from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.control_socket.commands import (
    LogCommand,
    MoveCommand,
    ParametersCommand,
    Refusal,
    ReplaceCommand,
    RobotStatus,
    StatusCommand,
    StopCommand,
    StopReport,
    TapCommand,
    TaskCommand,
)
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.manager import MOST_COMMANDS, Manager
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.observe.estimates import Estimates
from poise.manage.observe.sample_recording import Recording
from poise.manage.tasks.concurrent_tasks import Tasks
from poise.model.robot import Action, Robot, Task
from poise.wire.codec import pack
from poise.wire.records.request_records import PortAnswer
from poise.wire.records.status_records import (
    AgentSample,
    ComponentSample,
    ComponentStatus,
    ContainerSample,
    Fault,
)
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "thinker": "right"}
COMMAND = MoveCommand("thinker", "left", force=True)
CONFIGURING, FAILED = (
    ComponentStatus(name="thinker", epoch=1, state=state)
    for state in ("unconfigured", "failed")
)
"""The target of that move."""


class Managed:
    """A manager, its agents and its journal."""

    def __init__(self, robot: Robot) -> None:
        action = Action(name="work", functions=("seeing", "thinking"))
        robot = replace(robot, tasks=(Task(name="work", actions=(action,)),))
        tasks = Tasks(robot)
        tasks.start("work", 0.0)
        self.agents = FakeAgents("left", "right")
        self.journal = Journal(":memory:")
        agents = cast("Agents", self.agents)
        self.run = LiveRobot(robot, PLACEMENT, agents, self.journal, "/run")
        self.run.start()
        estimates = Estimates(robot, None, emulated=True)
        self.samples = Recording()
        self.manager = Manager(self.run, tasks.saved, estimates, self.samples)

    def sentences_of_move(self) -> list[str]:
        """Return what the journal got of a move that was asked for, in order."""
        before = len(self.journal.entries())
        future = self.manager.submit(COMMAND)
        self.manager.work(0.0)
        if not future.done():  # the target is being configured
            self.agents.report_component("left", FAILED)
            self.manager.work(0.0)
        result = future.result(0.0)
        assert isinstance(result, MigrationReport)
        assert not result.committed
        entries = self.journal.entries()[before:]
        asked, *others = [entry.what for entry in entries if entry.kind != "desired"]
        assert asked == "asked to move 'thinker' to 'left'"
        return others


@pytest.fixture
def managed(robot: Robot) -> Managed:
    return Managed(robot)


def used(at: float) -> AgentSample:
    """Return what was used: 10 % of a core, and from 20 s on 40 %."""
    cpu, jobs = 0.1 * at + 0.3 * max(0.0, at - 20), round(10 * at)
    thinker = ComponentSample("thinker", 0, cpu, 0.0, jobs, jobs)
    container = ContainerSample("think", 1, at, cpu, 1, (thinker,), ())
    return AgentSample("right", at, 0.0, (container,))


@pytest.mark.parametrize("ends", [False, True])
def test_drifts_are_told_until_the_simulated_world_ends(
    managed: Managed, *, ends: bool
) -> None:
    """It would need four times as much from 20 s on; the world may end there."""
    for numbers in (range(100), range(100, 300)):
        for k in numbers:
            managed.samples.add(used(0.2 * k))
        managed.manager.work(0.0)
        if ends:
            managed.manager.end_estimates()
    said = "".join(entry.what for entry in managed.journal.entries())
    assert ("'thinker' needs" in said) is not ends
    assert ("world has ended" in said) is ends


def test_the_status_tells_no_need_of_what_runs_no_more(managed: Managed) -> None:
    for k in range(100):
        managed.samples.add(used(0.2 * k))
    managed.manager.work(0.0)
    (need,) = managed.manager.status().demand_estimates
    assert need.component == "thinker"
    managed.run.commit(managed.run.desired.without(["thinker"]), "it ends")
    assert not managed.manager.status().demand_estimates


def test_a_fault_is_told_while_a_move_waits(managed: Managed) -> None:
    managed.agents.faults = (Fault(container="eye", message="was killed", number=1),)
    managed.agents.states["thinker"] = CONFIGURING
    sentences = managed.sentences_of_move()
    assert sentences[0] == "container 'eye' on 'left' was killed"
    assert sum("was killed" in each for each in sentences) == 2  # of both computers


def test_a_deviation_of_another_component_is_told_while_a_move_waits(
    managed: Managed,
) -> None:
    managed.agents.states["thinker"] = CONFIGURING
    failed = ComponentStatus(name="grabber", state="failed")
    managed.agents.states["grabber"] = failed
    managed.agents.report_component("left", failed)
    sentences = managed.sentences_of_move()
    assert sentences[0] == "component 'grabber' on 'left' is failed"
    assert sentences[1].startswith("did not move component 'thinker'")


def test_other_commands_are_carried_out_while_a_target_is_configured(
    managed: Managed,
) -> None:
    """They waited for as long as a user's `configure` took."""
    managed.agents.states["thinker"] = CONFIGURING
    moving = managed.manager.submit(COMMAND)
    managed.manager.work(0.0)
    (sentence,) = managed.manager.status().under_way
    assert sentence.startswith("component 'thinker' from 'right' to 'left' has been in")
    assert "is unconfigured, not yet inactive" in sentence
    other = managed.manager.submit(MoveCommand("grabber", "nowhere", dry=True))
    managed.manager.work(0.0)
    assert isinstance(other.result(0.0), Refusal)
    assert not moving.done()
    assert managed.run.placed["thinker"].goal == "active"
    managed.agents.report_component("left", FAILED)
    managed.manager.work(0.0)
    assert "cannot be configured on 'left'" in str(moving.result(0.0))
    assert managed.manager.status().under_way == ()
    assert managed.run.desired.configured_ahead == ()


def test_a_rehearsed_move_is_refused_as_the_move_would_be(managed: Managed) -> None:
    """A dry run looked at limits alone."""
    fixed = managed.run.robot.with_components(lambda c: replace(c, movable=False))
    managed.run.robot = fixed
    for dry in (True, False):
        asked = managed.manager.submit(MoveCommand("thinker", "left", dry=dry))
        managed.manager.work(0.0)
        refusal = asked.result(0.0)
        assert isinstance(refusal, Refusal)
        assert "'thinker' is not movable" in refusal.reason


def test_a_state_is_mapped_or_dropped(managed: Managed) -> None:
    command = ReplaceCommand("thinker", "new:Thinker", adapt="new:adapt", fresh=True)
    asked = managed.manager.submit(command)
    managed.manager.work(0.0)
    assert "give one of them" in str(asked.result(0.0))


def test_a_move_to_a_computer_that_is_out_of_reach_is_refused_at_once(
    managed: Managed,
) -> None:
    managed.agents.gone.add("left")
    managed.manager.work(0.0)  # from here on the manager goes on without it
    rehearsed = managed.manager.submit(MoveCommand("thinker", "left", dry=True))
    managed.manager.work(0.0)
    assert "computer 'left' has been out of reach since" in str(rehearsed.result(0.0))
    sentences = managed.sentences_of_move()
    assert "computer 'left' has been out of reach since" in sentences[-1]


def test_a_bug_in_a_command_is_refused_and_the_robot_goes_on(
    managed: Managed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def break_down(*_: object, **__: object) -> None:
        live = managed.run  # in the middle of a change
        live.commit(live.desired.aiming("stay", ["thinker"]), "odd")
        raise KeyError("odd")

    monkeypatch.setattr("poise.manage.manager.plan_move", break_down)
    future = managed.manager.submit(COMMAND)
    managed.manager.work(0.0)
    refusal = future.result(0.0)
    assert isinstance(refusal, Refusal)
    assert "KeyError: 'odd'" in refusal.reason
    (entry,) = (each for each in managed.journal.entries() if each.kind == "failed")
    assert "KeyError: 'odd'" in entry.what
    assert "break_down" in entry.facts["traceback"]
    assert managed.run.desired.settled().keys() == PLACEMENT.keys()


def test_a_thread_that_failed_is_in_the_status(managed: Managed) -> None:
    managed.manager.troubles.note_failure("metrics", KeyError("odd"))
    deviations = managed.manager.status().deviations
    assert ["thread 'metrics'" in each.what for each in deviations].count(True) == 1


def test_who_gave_up_waiting_gets_nothing_moved(managed: Managed) -> None:
    assert managed.manager.submit(COMMAND).cancel()
    managed.manager.work(0.0)
    assert managed.run.placement() == PLACEMENT
    assert not managed.run.desired.configured_ahead


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what components took as parameters; none of them runs."""
    names: list[str] = []

    def take(_: object, command: ParametersCommand) -> PortAnswer:
        names.append(command.component)
        return PortAnswer(number=1, outcome="done", value=command.changes)

    monkeypatch.setattr("poise.manage.manager.set_parameters", take)
    return names


def test_what_a_component_took_is_kept_although_its_client_left(
    managed: Managed, taken: list[str]
) -> None:
    changes = pack({"gain": 0.6})
    left = managed.manager.submit(
        ParametersCommand(component="thinker", changes=changes)
    )
    assert left.cancel()
    managed.manager.work(0.0)
    assert taken == ["thinker"]
    assert managed.run.desired.parameters["thinker"] == {"gain": 0.6}


def test_where_too_many_commands_wait_no_component_takes_parameters(
    managed: Managed, taken: list[str]
) -> None:
    for _ in range(MOST_COMMANDS):
        managed.manager.submit(MoveCommand("thinker", "right"))
    refused = managed.manager.submit(
        ParametersCommand(component="thinker", changes=pack({}))
    )
    assert "commands wait already" in str(refused.result(0.0))
    assert not taken


def test_a_stop_that_comes_after_the_end_is_answered(managed: Managed) -> None:
    managed.manager.end()
    asked = managed.manager.submit(StopCommand())
    assert asked.result(0.0) == StopReport(())


def test_the_journal_says_that_a_stop_was_asked_for(managed: Managed) -> None:
    managed.manager.submit(StopCommand())
    managed.manager.submit(StopCommand())
    said = [entry.what for entry in managed.journal.entries()]
    assert said.count("asked to stop the robot") == 1


def test_who_asks_for_a_stop_learns_what_remains_and_nothing_else(
    managed: Managed,
) -> None:
    managed.agents.gone.add("right")
    with pytest.raises(RunError, match="stopped, but") as left:
        managed.manager.stop()
    asked = managed.manager.submit(StopCommand())
    assert asked.result(0.0) == StopReport((str(left.value),))


def test_what_was_refused_is_not_said_to_be_done(
    managed: Managed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No majority of agents stores anything meanwhile."""
    monkeypatch.setattr(managed.agents, "has_stored", lambda _: False)
    refused = managed.manager.submit(TaskCommand("start", "sing"))
    done = managed.manager.submit(TaskCommand("pause", "work"))
    for _ in range(2):
        managed.manager.work(0.0)
    assert not done.done()
    monkeypatch.setattr(managed.run.clock, "now", lambda: 1e9)
    managed.manager.work(0.0)
    why = refused.result(0.0)
    assert isinstance(why, Refusal)
    assert why.reason.startswith("robot 'tiny' has no task 'sing'")
    why = done.result(0.0)
    assert isinstance(why, Refusal)
    assert why.reason.startswith("it was done, but no majority")


def test_what_was_refused_is_said_so_when_the_robot_stops(
    managed: Managed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(managed.agents, "has_stored", lambda _: False)
    refused = managed.manager.submit(TaskCommand("start", "sing"))
    managed.manager.work(0.0)
    managed.manager.stop()
    why = refused.result(0.0)
    assert isinstance(why, Refusal)
    assert why.reason.startswith("robot 'tiny' has no task 'sing'")


def test_a_status_waits_for_nothing_that_the_manager_does(managed: Managed) -> None:
    waiting = managed.manager.submit(COMMAND)
    assert managed.manager.submit(StatusCommand()).done()
    assert not waiting.done()


def test_a_lost_computer_is_told_once(managed: Managed) -> None:
    managed.agents.lose_when_told = "right"
    sentences = managed.sentences_of_move()
    managed.manager.work(0.0)
    said = [
        s for s in sentences if s.startswith("computer 'right' has been out of reach")
    ]
    assert len(said) == 1


def test_why_a_record_of_an_agent_was_refused_is_told(managed: Managed) -> None:
    managed.agents.refused = ["a record at poise/tiny/status/left was refused: odd"]
    managed.manager.work(0.0)
    assert managed.journal.entries()[-1].what.endswith("was refused: odd")


def test_a_robot_that_is_being_stopped_says_what_that_waits_for(
    managed: Managed,
) -> None:
    assert managed.manager.status().under_way == ()
    managed.manager.submit(StopCommand())
    status = managed.manager.submit(StatusCommand()).result(0.0)
    assert isinstance(status, RobotStatus)
    [sentence] = status.under_way
    assert sentence.startswith("the stop waits for `deactivate` and `cleanup` of '")
    slow = ComponentStatus(name="thinker", state="active", handler="deactivate")
    managed.agents.report_component("right", slow)
    [sentence] = managed.manager.status().under_way
    assert sentence == "the stop waits for `deactivate` and `cleanup` of 'thinker'"


@pytest.mark.parametrize("command", [TapCommand("a.b", "me"), LogCommand(), COMMAND])
def test_a_robot_that_is_being_stopped_says_so(
    managed: Managed, command: TapCommand | LogCommand | MoveCommand
) -> None:
    managed.manager.submit(StopCommand())
    answer = managed.manager.submit(command).result(0.0)
    assert answer == Refusal("the robot is being stopped", "RunError")


def test_what_is_being_changed_is_told_with_what_that_waits_for(
    managed: Managed,
) -> None:
    """It stayed out of `status`, for as long as the change took."""
    run = managed.run
    new = run.begun("thinker", "left").with_goal("inactive")
    managed.agents.states["thinker"] = CONFIGURING
    run.commit(run.desired.aiming("stay", {"grabber"}).with_coming([new]), "a change")
    [sentence] = managed.manager.status().under_way
    names = "being started, moved, replaced or stopped: 'grabber', 'thinker'"
    waits = "component 'thinker' on 'left' is unconfigured, not yet inactive"
    assert sentence.startswith(f"{names}; {waits}")
    run.commit(run.desired.aiming("active", {"grabber"}).with_coming([]), "it is over")
    assert managed.manager.status().under_way == ()
