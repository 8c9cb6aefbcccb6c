"""What a migration asks of agents, and what comes of it when they fail."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from types import SimpleNamespace
from typing import cast

import pytest
from msgspec import structs

from poise.errors import RunError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.requests import PendingAnswer
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration import coordinator
from poise.manage.migration.coordinator import Migration
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import plan_move
from poise.model.robot import Computer, Robot
from poise.wire.records import migration_records as records
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.heartbeat_records import LinkQuality
from tests.manage.conftest import FakeAgents

PLACEMENT = {"grabber": "left", "filter": "left", "thinker": "far"}
STEP = 0.05
"""A step takes so long, unless a test says otherwise [s]."""


class MovingAgents(FakeAgents):
    """Agents whose containers take steps, as far as a test lets them.

    `failing`: step -> how often it fails; `taking`: step -> how long it takes [s];
    `on_step`: step -> what happens meanwhile; `seen`: the computer, what was asked of
    it and when: steps, and where the filter is.
    """

    def __init__(self) -> None:
        super().__init__("left", "right", "far")
        self.now = 100.0
        self.failing: dict[str, int] = {}
        self.taking: dict[str, float] = {}
        self.on_step: dict[str, Callable[[], object]] = {}
        self.seen: list[tuple[str, str, float]] = []

    def send_steps(
        self,
        batches: Iterable[tuple[str, records.MigrationSteps]],
        check: Callable[[], object] = lambda: None,
    ) -> Iterator[records.StepsOutcome]:
        for computer, asked in batches:
            check()
            yield self._outcome(computer, asked)

    def _outcome(
        self, computer: str, asked: records.MigrationSteps
    ) -> records.StepsOutcome:
        taken: list[records.StepTaken] = []
        for step in asked.steps:
            self.seen.append((computer, step.name, self.now))
            self.on_step.get(step.name, lambda: None)()
            began, self.now = self.now, self.now + self.taking.get(step.name, STEP)
            if self.failing.get(step.name, 0):
                self.failing[step.name] -= 1
                return records.StepsFailed(
                    asked.number, f"no {step.name}", tuple(taken)
                )
            who = step.component or "eye"
            taken.append(records.StepTaken(who, step.name, step.phase, began, self.now))
        return records.StepsDone(asked.number, tuple(taken))

    def begin_deploy(self, computer: str, deployment: Deployment) -> PendingAnswer:
        goals = [c.goal for c in deployment.components if c.name == "filter"]
        self.seen.append((computer, f"filter {''.join(goals) or 'ends'}", self.now))
        return super().begin_deploy(computer, deployment)

    def report_filter(self, **known: object) -> None:
        """Let it be reported otherwise."""
        (found,) = [c for c in self.statuses()["left"].components if c.name == "filter"]
        self.report_component("left", structs.replace(found, **known))

    def cut(self, other: str, silent: float = 0.9) -> None:
        """Let `left` not have heard another computer for so long [s]."""
        quality = LinkQuality(delay=None, loss=0.0, silent=silent)
        status = self.statuses()["left"]
        self.report(structs.replace(status, links={other: quality}))

    def steps(self) -> list[str]:
        return [what for _, what, _ in self.seen if not what.startswith("filter")]

    def deployments(self, computer: str) -> list[str]:
        return [
            what for at, what, _ in self.seen if at == computer and "filter" in what
        ]


@pytest.fixture
def agents(monkeypatch: pytest.MonkeyPatch) -> MovingAgents:
    agents = MovingAgents()

    def sleep(seconds: float) -> None:
        agents.now += seconds

    time = SimpleNamespace(monotonic=lambda: agents.now, sleep=sleep)
    for module in (coordinator, records):
        monkeypatch.setattr(module, "time", time)
    return agents


@pytest.fixture
def live(robot: Robot, agents: MovingAgents) -> LiveRobot:
    robot = structs.replace(robot, computers=(*robot.computers, Computer(name="far")))
    journal = Journal(":memory:")
    live = LiveRobot(robot, PLACEMENT, cast("Agents", agents), journal, "/run")
    live.start()
    agents.seen.clear()
    return live


def move(live: LiveRobot) -> MigrationReport:
    return plan_move(live, "filter", "right").run()


def failures(live: LiveRobot) -> list[str]:
    found = [entry.what for entry in live.journal.entries() if entry.kind == "failed"]
    return [what.removeprefix("migration of component 'filter': ") for what in found]


def test_the_target_works_once_the_source_does_not_and_agents_are_told_afterwards(
    live: LiveRobot, agents: MovingAgents
) -> None:
    """Told earlier, a source would end while callers wait to be sent on."""
    agents.taking = {"pause": 0.5, "offer state": 7.0}
    old, began = live.placed["filter"], agents.now
    report = move(live)
    assert (report.committed, report.reason, failures(live)) == (True, "", [])
    new = live.placed["filter"]
    assert (new.computer, new.goal, new.epoch) == ("right", "active", old.epoch + 1)
    assert agents.deployments("left") == ["filter stay", "filter ends"]
    assert agents.deployments("right") == ["filter inactive", "filter active"]
    steps, last = agents.steps(), "release to targets"
    assert steps[-1] == last
    order = ["offer state", "buffer", "pause", "send state", "resume", last]
    assert sorted(order, key=steps.index) == order
    at = {what: moment for _, what, moment in agents.seen}
    assert 0.1 < at["filter ends"] - at[last] < 0.3
    assert report.downtime == pytest.approx(at[last] + STEP - at["buffer"])
    assert report.phases["prepare"] == pytest.approx(at["buffer"] - began)
    assert report.phases["quiesce"] == pytest.approx(0.5 + 2 * STEP)
    assert [step.step for step in report.steps] == steps


@pytest.mark.parametrize("step", ["pre-copy", "buffer", "pause", "restore state"])
def test_before_the_commit_any_failure_lets_the_source_go_on(
    live: LiveRobot, agents: MovingAgents, step: str
) -> None:
    old = live.placed["filter"]
    agents.failing[step] = 1
    report = move(live)
    assert (report.committed, report.reason) == (False, f"no {step}")
    assert (live.placed["filter"], live.desired.coming) == (old, ())
    assert agents.deployments("left")[-1] == "filter active"
    assert agents.deployments("right") == ["filter inactive", "filter ends"]
    assert "resume" not in agents.steps()
    assert "roll back" in report.phases
    is_paused = step != "pre-copy"
    assert agents.steps()[-2:] == ["roll back", "release to sources"] or not is_paused
    assert (report.downtime > 0) == is_paused
    assert failures(live) == [f"did not move {report.way}: no {step}"]


def test_a_pause_that_lasts_too_long_is_ended_before_its_next_round(
    live: LiveRobot, agents: MovingAgents
) -> None:
    agents.report_filter(requires=("clean",))  # so it pauses before what it calls
    sources = tuple(live.placed[name] for name in ("filter", "thinker"))
    targets = tuple(
        structs.replace(each, computer="right", epoch=each.epoch + 1, goal="inactive")
        for each in sources
    )
    report = MigrationReport(what="filter", before={}, after={})
    agents.taking["pause"] = 1.5
    report = Migration(live, report, sources, targets).run()
    assert report.reason == "the downtime reached 1.4 s"
    assert agents.steps().count("pause") == 1


MAY_SEND = "'grabber' may still send to the earlier place"


@pytest.mark.parametrize(("times", "said"), [(3, []), (1000, [MAY_SEND])])
def test_after_the_commit_nothing_undoes_it_and_the_source_waits_for_senders(
    live: LiveRobot, agents: MovingAgents, times: int, said: list[str]
) -> None:
    agents.failing = {"resume": 1, "release to targets": times}
    assert move(live).committed
    assert "roll back" not in agents.steps()
    assert min(times + 1, 26) <= agents.steps().count("release to targets") < 30
    assert agents.steps().count("resume") == 1
    known = {"no release to targets", "no resume"}
    assert set(failures(live)) == {*known, *said}
    assert agents.deployments("left")[-1] == "filter ends"


def test_nothing_is_paused_while_the_state_cannot_be_had_or_cannot_go_there(
    live: LiveRobot, agents: MovingAgents
) -> None:
    def reason() -> str:
        report = move(live)
        assert not report.committed
        assert "offer state" not in agents.steps()
        return report.reason

    agents.report_filter(state="inactive")
    assert reason().endswith("its state cannot be transferred")
    agents.report_filter(state="active")
    agents.cut("right")
    assert reason().startswith("link 'left-right' is cut: the state of component")
    agents.cut("right", 0.5)
    agents.deaf.add("right")
    assert reason().startswith("not ready within 30 s: computer 'right' is silent")
    agents.gone.add("right")
    assert reason().startswith("computer 'right' has been out of reach since")
    agents.gone.clear()
    live.cancel()
    assert reason() == "the robot is being stopped"


def test_a_commit_that_no_agent_knows_of_is_no_success(
    live: LiveRobot, agents: MovingAgents
) -> None:
    """Whoever leads next knows of none, and undoes it."""
    agents.on_step["resume"] = lambda: agents.deaf.update(("left", "right"))
    with pytest.raises(RunError, match="is committed, but no agent could be told"):
        move(live)
