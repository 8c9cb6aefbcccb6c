"""Moves between real agents: each ends where it should, whatever goes wrong."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from poise.errors import RunError, UsageError
from poise.manage.agent_connections.agents import Agents
from poise.manage.agent_connections.requests import AgentRequests, PendingAnswer
from poise.manage.agent_connections.statuses import components_of, connectors_of
from poise.manage.deploy.deactivation import stop
from poise.manage.deploy.live_robot import LiveRobot
from poise.manage.journal import Journal
from poise.manage.migration.coordinator import DOWNTIME_LIMIT, RESUME_LIMIT
from poise.manage.migration.migration_report import MigrationReport
from poise.manage.migration.move import plan_move, plan_replacement
from poise.manage.migration.pending_migration import PREPARE_LIMIT
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.wire.records.deployment_records import Deployment
from poise.wire.records.migration_records import MigrationSteps, StepName, StepsOutcome
from poise.wire.records.request_records import Refused
from poise.wire.records.status_records import Fault
from tests.manage.agents import TELLING, TwoAgents, two_agents
from tests.model_of_moves.replay import replay
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

LIMIT = 20.0
ROUNDS: tuple[StepName, ...] = (
    "offer state",
    "pause",
    "resume",
)
"""A step in each round of a move."""
JOINTS: tuple[tuple[str, str], ...] = (
    ("source.numbers", "counter.numbers"),
    ("source.doubles", "counter.doubles"),
    ("counter.passed", "sink.passed"),
)
CODE = (
    TELLING
    + '''
class Counted(Message):
    last: int
    wrong: int
    ticks: int

class Counter(Component):
    """Counts the numbers that do not follow the last."""

    passed: Published[Number]
    doubles: Provided[Doubles]

    def configure(self):
        self.state = Counted(0, 0, 0)

    def double(self, value: int) -> int:
        return 2 * value

    @subscribed(block=100)
    def numbers(self, message: Number):
        last, wrong, ticks = self.state.last, self.state.wrong, self.state.ticks
        self.state = Counted(message.value, wrong + (message.value != last + 1), ticks)
        self.passed.publish(message)

    @every(0.05)
    def tick(self):
        self.state = Counted(self.state.last, self.state.wrong, self.state.ticks + 1)

    def snapshot(self) -> Counted:
        return self.state

    def restore(self, state: Counted) -> None:
        self.state = state

class Large(Message):
    data: bytes
    counted: Counted

class Gradual(Counter):
    """Sends a large state while it works, and then only what changed."""

    def configure(self):
        super().configure()
        self.data = bytes(2_000_000)

    def snapshot(self) -> Large:
        return Large(self.data, self.state)

    def restore(self, state: Large) -> None:
        assert len(state.data) == 2_000_000
        self.state = state.counted

    def snapshot_delta(self) -> Counted:
        return self.state

    def restore_delta(self, delta: Counted) -> None:
        self.state = delta

class Slow(Counter):
    """Cannot keep up: its publisher has to wait, wherever it is."""

    @subscribed(block=3)
    def numbers(self, message: Number):
        threading.Event().wait(0.02)
        super().numbers(message)

class Unrestorable(Counter):
    def restore(self, state: Counted) -> None:
        raise LookupError("no such map")

class Unactivatable(Counter):
    def activate(self):
        if self.state.last:
            raise LookupError("no such motor")

class Unsnapshotable(Counter):
    def snapshot(self) -> Counted:
        raise LookupError("no such tape")

class Lingering(Counter):
    """Takes its snapshot as long as a file is there."""

    def snapshot(self) -> Counted:
        lingers = os.path.join(self.parameters["folder"], "lingers")
        while os.path.exists(lingers):
            threading.Event().wait(0.01)
        return self.state

class LingeringFirst(Gradual):
    """Takes its first snapshot as long as a file is there."""

    snapshot_now = Lingering.snapshot

    def snapshot(self) -> Large:
        self.snapshot_now()
        return super().snapshot()

class Unwritable(Counter):
    def snapshot(self) -> Counted:
        return Counted(object(), 0, 0)

class Untyped(Counter):
    def restore(self, state):
        self.state = state

class Unrestoring(Counter):
    restore = Component.restore

class Late(Counter):
    """Takes longer to restore than its callers wait."""

    def restore(self, state: Counted) -> None:
        threading.Event().wait(0.3)
        self.state = state

class Calling(Counter):
    """Calls whoever calls it, in the same chain."""

    helps: Required[Doubles]

    def double(self, value: int) -> int:
        return self.helps.double(value)

class Called(Source):
    """Is calrolled back by what it calls."""

    helps: Provided[Doubles]
    reentrant = True

    def double(self, value: int) -> int:
        return 2 * value

class Hanging(Counter):
    def activate(self):
        if self.state.last:
            threading.Event().wait(60)

class Busy(Counter):
    """Is busy as long as a file is there, and tells so by another."""

    @every(0.01)
    def dawdle(self):
        busy = os.path.join(self.parameters["folder"], "busy")
        while os.path.exists(busy):
            open(busy + "-now", "w").close()
            threading.Event().wait(0.01)

class Tripled(Message):
    end: int

class Adapted(Counter):
    def restore(self, state: Tripled) -> None:
        self.state = Counted(state.end, 0, 0)

def adapt(old: Counted) -> Tripled:
    return Tripled(old.last)

class Sink(Telling):
    def configure(self):
        super().configure()
        self.last = self.wrong = 0

    @subscribed(block=100)
    def passed(self, message: Number):
        self.wrong += message.value != self.last + 1
        self.last = message.value
        self.tell(self.last, self.wrong)
'''
)


class Striking:
    """Agents; something happens before a round of steps."""

    def __init__(self, agents: Agents) -> None:
        self._agents = agents
        self.begin_deploy = agents.begin_deploy
        self.before: dict[StepName, Callable[[], None]] = {}

    def __getattr__(self, name: str) -> object:
        return getattr(self._agents, name)

    def send_steps(
        self,
        batches: Iterable[tuple[str, MigrationSteps]],
        check: Callable[[], object] = lambda: None,
    ) -> Iterator[StepsOutcome]:
        told = list(batches)
        names = {step.name for _, batch in told for step in batch.steps}
        for name in names & self.before.keys():
            self.before.pop(name)()
        return self._agents.send_steps(told, check)


class MovingRobot:
    """Two agents, and a robot whose `counter` moves between them."""

    def __init__(
        self, folder: Path, agents: Agents, journal: Journal, name: str
    ) -> None:
        self.folder = folder
        self.name = name
        self.striking = Striking(agents)
        self.journal = journal
        self.extra: tuple[ComponentEntry, ...] = ()
        self.source = "Source"
        self.joints = JOINTS
        self.limit = 3.0
        self.chance = random.Random(1)
        self.live: LiveRobot

    def start(
        self, counter: str, source: str = "left", *, isolated: bool = False
    ) -> LiveRobot:
        (self.folder / self.name).mkdir()
        robot = self._robot(counter, isolated=isolated)
        placement = {"source": source, "counter": "left", "sink": "left"}
        placement |= {component.name: "left" for component in self.extra}
        agents: Agents = self.striking  # type: ignore[assignment] # it stands in for one
        self.live = LiveRobot(robot, placement, agents, self.journal, str(self.folder))
        self.live.start()
        self.works()
        return self.live

    def told(self, component: str) -> tuple[int, int]:
        """Return what a component tells: progress, and what went wrong."""
        with contextlib.suppress(FileNotFoundError):
            said = (self.folder / self.name / component).read_bytes()
            if said:
                return int(said[:10]), int(said[10:])
        return 0, 0

    def wrong(self) -> int:
        """Return how many numbers or answers did not come as they should."""
        return self.told("sink")[1] + self.told("source")[1]

    @contextlib.contextmanager
    def standing_still(self, component: str, seconds: float) -> Iterator[None]:
        """Stop a component's containers before some round, for so long [s]."""
        container = self.live.layout.container_of(self.live.placed[component])
        stopped = [
            each.pid
            for status in self.live.agents.statuses().values()
            for each in status.containers
            if each.name == container
        ]

        def send(number: signal.Signals) -> None:
            for pid in stopped:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)

        going_on = threading.Timer(seconds, send, [signal.SIGCONT])

        def strike() -> None:
            send(signal.SIGSTOP)
            going_on.start()

        self.striking.before[self.chance.choice(ROUNDS)] = strike
        try:
            yield
        finally:
            self.striking.before.clear()
            if going_on.is_alive():
                going_on.join(LIMIT)

    def wait_for(self, holds: Callable[[], bool]) -> None:
        assert self.live.agents.wait_news(holds, LIMIT)

    def works(self) -> None:
        """Wait until numbers go through, and calls are answered."""
        for component in ("sink", "source"):
            before = self.told(component)[0]
            wait_until(lambda b=before, c=component: self.told(c)[0] not in {0, b})  # type: ignore[misc]

    def kill(self, computer: str, component: str) -> None:
        """Kill the container of a component, and wait until that is seen."""
        container = self.live.layout.container_of(self.live.placed[component])
        before = self.faults(container)
        for each in self.live.agents.statuses()[computer].containers:
            if each.name == container:
                os.kill(each.pid, signal.SIGKILL)
        self.wait_for(lambda: self.faults(container) != before)

    def faults(self, container: str) -> list[Fault]:
        """Return those of a container: agents also keep those of earlier tests."""
        return [
            fault
            for status in self.live.agents.statuses().values()
            for fault in status.faults
            if fault.container == container
        ]

    def active(self) -> list[str]:
        """Return where a `counter` is active, by what was said last."""
        return [
            computer
            for computer, status in self.live.current().items()
            for component in components_of({computer: status})
            if (component.name, component.state) == ("counter", "active")
        ]

    def _robot(self, counter: str, *, isolated: bool) -> Robot:
        implementations = {"source": self.source, "counter": counter, "sink": "Sink"}
        architecture = Architecture(
            name=self.name,
            function="one",
            components=tuple(
                ComponentEntry(
                    name=n,
                    implementation=f"moved:{c}",
                    isolated=isolated,
                    parameters={"folder": str(self.folder / self.name)},
                )
                for n, c in implementations.items()
            )
            + self.extra,
            connectors=tuple(
                Connector(
                    between=(ConnectorEnd(*a.split(".")), ConnectorEnd(*b.split("."))),
                    limit=self.limit,
                )
                for a, b in self.joints
            ),
        )
        capacity = {"cpu": 1.0, "memory": 1e9}
        names = ("left", "right")
        return Robot(
            name="moves",
            folder=str(self.folder),
            computers=tuple(Computer(name=n, capacity=capacity) for n in names),
            architectures=(architecture,),
        )


def _two_agents() -> Iterator[TwoAgents]:
    with two_agents(f"moves{os.getpid()}", "moved", CODE) as found:
        yield found


pair = pytest.fixture(scope="module", name="pair")(_two_agents)
mortals = pytest.fixture(name="mortals")(_two_agents)
"""Agents that a test may kill."""


def _world(pair: TwoAgents, name: str) -> Iterator[MovingRobot]:
    """Give each test containers with names, and so back-offs, of their own."""
    journal = Journal(":memory:")
    name = f"c{abs(hash(name)) % 10**8}"
    world = MovingRobot(pair.folder, pair.agents, journal, name)
    yield world
    with contextlib.suppress(RunError):  # of an agent that the test killed
        stop(world.live)
    journal.close()


@pytest.fixture
def world(
    pair: TwoAgents, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[MovingRobot]:
    # a busy machine may keep these agents silent for longer; they live
    monkeypatch.setattr(
        "poise.manage.agent_connections.reachability.UNHEARD_AFTER", LIMIT
    )
    yield from _world(pair, request.node.name)


@pytest.fixture
def mortal(mortals: TwoAgents, request: pytest.FixtureRequest) -> Iterator[MovingRobot]:
    yield from _world(mortals, request.node.name)


def assert_bounded(report: MigrationReport) -> None:
    """Allow the downtime its limits, and time on a machine that is busy otherwise."""
    assert report.downtime < DOWNTIME_LIMIT + RESUME_LIMIT + LIMIT / 2


def move_counter(live: LiveRobot, computer: str) -> None:
    """Move the counter, with time for that on a machine that is busy otherwise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("poise.manage.migration.coordinator.DOWNTIME_LIMIT", LIMIT)
        report = plan_move(live, "counter", computer).run()
    assert report.committed, report.reason
    assert replay(report, "counter") == ""


@pytest.mark.parametrize(
    ("source", "containers"), [("left", "one"), ("left", "two"), ("right", "one")]
)
def test_nothing_is_lost_doubled_or_reordered(
    world: MovingRobot, source: str, containers: str
) -> None:
    """There and back: the other ends are direct, local and remote in turn."""
    run = world.start("Counter", source, isolated=containers == "two")
    for computer in ("right", "left", "right", "left"):
        move_counter(run, computer)
    world.works()
    assert world.wrong() == 0


def test_a_large_state_goes_ahead_and_timers_keep_on(world: MovingRobot) -> None:
    run = world.start("Gradual")
    move_counter(run, "right")
    world.works()
    assert world.told("sink")[1] == 0


def test_a_publisher_waits_for_a_slow_subscriber_that_moves(
    world: MovingRobot,
) -> None:
    run = world.start("Slow")
    for target in ("right", "left", "right"):
        move_counter(run, target)
        world.works()

    def waits() -> bool:
        """Whether a publication took as long as the subscriber's work."""
        ends = connectors_of(run.agents.statuses())
        return any(end.wait.maximum > 0.015 for end in ends if end.end == "source")

    world.wait_for(waits)
    assert world.wrong() == 0
    assert sum(end.drops for end in connectors_of(run.agents.statuses())) == 0


@pytest.mark.parametrize(
    ("implementation", "words"),
    [
        ("Unrestorable", "LookupError: no such map"),
        ("Unactivatable", "LookupError: no such motor"),
        ("Hanging", "`activate` has not ended after|took over"),
        ("Unsnapshotable", "LookupError: no such tape"),
        ("Unwritable", "WireError: a value of type object cannot cross"),
        (
            "Unrestoring",
            "Unrestoring has no `restore`, so the state would be lost",
        ),
        ("Untyped", "Untyped.restore: parameter 'state' must say the state's type"),
    ],
)
def test_rolls_back_when_the_component_cannot_move(
    world: MovingRobot, implementation: str, words: str
) -> None:
    run = world.start(implementation)
    report = plan_move(run, "counter", "right").run()
    assert not report.committed
    assert re.search(words, report.reason)
    assert replay(report, "counter") == ""
    assert_bounded(report)
    assert run.placement()["counter"] == "left"
    world.works()
    assert world.told("sink")[1] == 0


def test_what_cannot_give_its_state_is_replaced_without_it(world: MovingRobot) -> None:
    """It was asked for the state that `--fresh` drops, and so could not be mended."""
    run = world.start("Unsnapshotable")
    report = plan_replacement(run, "counter", "moved:Counter", fresh=True).run()
    assert report.committed, report.reason
    world.works()
    assert world.told("sink")[1] == 0


def test_rolls_back_and_says_so_when_the_component_does_not_come_to_rest(
    world: MovingRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the component's own limit is the smaller one; here by more than machines stall
    monkeypatch.setattr("poise.manage.migration.coordinator.DOWNTIME_LIMIT", 6.0)
    run = world.start("Busy")
    busy = world.folder / world.name / "busy"
    busy.touch()
    wait_until(lambda: busy.with_name("busy-now").exists())
    report = plan_move(run, "counter", "right").run()
    busy.unlink()
    assert not report.committed
    assert "component 'counter' did not pause" in report.reason
    world.works()
    assert world.told("sink")[1] == 0


def test_goes_on_in_its_container_when_a_snapshot_that_took_too_long_ends(
    world: MovingRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poise.manage.migration.coordinator.DOWNTIME_LIMIT", 0.5)
    run = world.start("Lingering")
    lingers = world.folder / world.name / "lingers"
    lingers.touch()
    first = plan_move(run, "counter", "right").run()
    second = plan_move(run, "counter", "right").run()  # while that snapshot is taken
    assert (first.committed, second.committed) == (False, False)
    lingers.unlink()
    world.works()
    assert not world.faults(run.layout.container_of(run.placed["counter"]))
    assert world.told("sink")[1] == 0
    monkeypatch.undo()
    move_counter(run, "right")
    world.works()
    assert world.told("sink")[1] == 0


def test_a_move_after_one_that_rolled_back_succeeds(world: MovingRobot) -> None:
    run = world.start("Counter")
    world.striking.before["pause"] = lambda: world.kill("right", "counter")
    first, second = (
        plan_move(run, "counter", "right").run(),
        plan_move(run, "counter", "right").run(),
    )
    assert (first.committed, second.committed) == (False, True), second.reason
    world.works()
    assert world.told("sink")[1] == 0


def test_a_stop_ends_a_move_amid_the_pre_copy_of_its_state(
    world: MovingRobot,
) -> None:
    run = world.start("LingeringFirst")
    lingers = world.folder / world.name / "lingers"
    lingers.touch()
    world.striking.before["pre-copy"] = run.cancel
    try:
        report = plan_move(run, "counter", "right").run()
    finally:
        lingers.unlink()
    assert report.reason == "the robot is being stopped"
    assert run.placed["counter"].computer == "left"
    world.works()
    assert world.wrong() == 0


def test_a_move_into_a_frozen_container_is_not_begun(world: MovingRobot) -> None:
    """It waited for 30 s, and said only that the component was not there."""
    run = world.start("Counter", "right")
    (container,) = run.agents.statuses()["right"].containers
    os.kill(container.pid, signal.SIGSTOP)
    try:
        world.wait_for(lambda: bool(run.unresponsive([run.placed["source"]])))
        report = plan_move(run, "counter", "right").run()
    finally:
        os.kill(container.pid, signal.SIGCONT)
    assert not report.committed
    where = f"container '{container.name}' on 'right' does not respond: "
    assert report.reason.startswith(f"{where}its process is stopped")
    world.works()
    assert world.told("sink")[1] == 0


def test_a_move_away_from_a_frozen_container_fails_soon(world: MovingRobot) -> None:
    """It said nothing for 30 s: the source offered its state when it went on."""
    run = world.start("Counter", "right", isolated=True)
    container = run.layout.container_of(run.placed["counter"])
    (pid,) = (
        each.pid
        for each in run.agents.statuses()["left"].containers
        if each.name == container
    )
    world.striking.before["offer state"] = lambda: os.kill(pid, signal.SIGSTOP)
    started = time.monotonic()
    report = plan_move(run, "counter", "right").run()
    took = time.monotonic() - started
    os.kill(pid, signal.SIGCONT)
    assert not report.committed
    assert re.search("does not respond|is unresponsive", report.reason)
    assert took < PREPARE_LIMIT / 3
    world.works()
    assert world.told("sink")[1] == 0


def test_a_missing_implementation_is_not_put_in(world: MovingRobot) -> None:
    run = world.start("Counter")
    report = plan_replacement(run, "counter", "moved:Nowhere").run()
    assert not report.committed
    assert "has no class 'Nowhere'" in report.reason
    assert report.downtime == 0.0
    world.works()
    assert world.told("sink")[1] == 0


def test_code_that_ends_its_container_is_no_crash_loop(world: MovingRobot) -> None:
    """It was tried until its container counted as one that crashes again and again."""
    run = world.start("Counter", isolated=True)
    (world.folder / "deadly.py").write_text("import os\n\nos._exit(3)\n")
    pending = plan_replacement(run, "counter", "deadly:Counter").configure_ahead()
    world.wait_for(pending.is_decided)
    report = pending.run()
    assert not report.committed
    assert "ended with exit code 3" in report.reason
    world.works()
    health = run.health_of(run.placed["counter"])
    assert health is not None
    assert 1 <= health.restarts < 5  # else a policy restarts it elsewhere


def test_a_slow_import_of_a_target_holds_up_nothing(world: MovingRobot) -> None:
    """The container's control thread imported: it heard and reported nothing."""
    run = world.start("Counter")
    may_end = world.folder / world.name / "may-end"
    (world.folder / "slowly.py").write_text(
        "import pathlib, threading\n"
        f"while not pathlib.Path({str(may_end)!r}).exists():\n"
        "    threading.Event().wait(0.01)\n"
        "from moved import Counter\n"
    )

    def is_importing() -> bool:
        components = components_of(run.agents.statuses())
        return any((c.name, c.state) == ("counter", "unconfigured") for c in components)

    with ThreadPoolExecutor(1) as pool:
        replacing = pool.submit(plan_replacement(run, "counter", "slowly:Counter").run)
        try:
            world.wait_for(is_importing)
            world.works()
            assert not replacing.done()
        finally:
            may_end.touch()
        assert replacing.result(LIMIT).committed, replacing.result().reason
    world.works()
    assert world.told("sink")[1] == 0


def test_an_implementation_is_replaced_and_its_state_adapted(
    world: MovingRobot,
) -> None:
    run = world.start("Counter")
    report = plan_replacement(run, "counter", "moved:Adapted", "moved:adapt").run()
    assert (report.committed, report.reason) == (True, "")
    world.works()
    assert world.told("sink")[1] == 0


@pytest.mark.parametrize("victim", [("left", "counter"), ("right", "counter")])
@pytest.mark.parametrize("before", ROUNDS)
def test_a_container_that_is_killed_between_two_rounds(
    world: MovingRobot, victim: tuple[str, str], before: StepName
) -> None:
    run = world.start("Counter", isolated=True)
    world.striking.before[before] = lambda: world.kill(*victim)
    started = time.monotonic()
    report = plan_move(run, "counter", "right").run()
    assert time.monotonic() - started < LIMIT
    assert replay(report, "counter", kills=1) == ""
    assert_bounded(report)
    if victim[0] == "right" and before != "offer state":  # it may be back then
        assert report.committed == (before == "resume")
    world.works()
    world.wait_for(lambda: world.active() == [run.placement()["counter"]])


@pytest.mark.parametrize("before", ["pause", "resume"])
def test_a_source_that_is_killed_between_two_rounds(
    world: MovingRobot, before: StepName
) -> None:
    run = world.start("Counter", "right", isolated=True)
    world.striking.before[before] = lambda: world.kill("right", "source")
    report = plan_move(run, "counter", "right").run()
    assert_bounded(report)
    world.works()
    world.wait_for(lambda: world.active() == [run.placement()["counter"]])


@pytest.mark.parametrize("before", ["pause", "resume"])
def test_a_sink_that_is_killed_between_two_rounds(
    world: MovingRobot, before: StepName
) -> None:
    run = world.start("Counter", isolated=True)
    world.striking.before[before] = lambda: world.kill("left", "sink")
    report = plan_move(run, "counter", "right").run()
    assert_bounded(report)
    world.works()
    world.wait_for(lambda: world.active() == [run.placement()["counter"]])


@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_lost_when_containers_stand_still_amid_moves(
    world: MovingRobot, seed: int
) -> None:
    """Half as long as makes a connection lost: a busy machine adds to it."""
    world.limit = 2 * LIMIT  # far longer than they do
    world.chance = chance = random.Random(seed)
    run = world.start("Counter", isolated=True)
    for _ in range(5):
        other = "left" if run.placement()["counter"] == "right" else "right"
        component = chance.choice(("source", "counter", "sink"))
        with world.standing_still(component, chance.uniform(0.1, 1.5)):
            # it may move again before what stood still has heard that it rolled back
            for _ in range(2):
                if run.placement()["counter"] != other:
                    plan_move(run, "counter", other).run()
    world.wait_for(lambda: world.active() == [run.placement()["counter"]])
    world.works()
    # a call may have been refused: its caller stood still when it had chosen its way
    assert world.told("sink")[1] == 0


@pytest.mark.parametrize("before", ROUNDS)
def test_goes_on_when_the_targets_agent_dies(
    mortal: MovingRobot, mortals: TwoAgents, before: StepName
) -> None:
    run = mortal.start("Counter")

    def strike() -> None:
        mortals.processes["right"].kill()
        mortals.processes["right"].wait(LIMIT)

    mortal.striking.before[before] = strike
    report = plan_move(run, "counter", "right").run()
    assert_bounded(report)
    # what had answered before it could be told that all have done so stays gone
    assert report.committed == (before == "resume")
    if before != "resume":
        assert "computer 'right' has been out of reach since" in report.reason
        assert run.placement()["counter"] == "left"
        mortal.works()
        assert mortal.told("sink")[1] == 0


def test_the_sources_resume_without_waiting_for_why_an_agent_is_silent(
    mortal: MovingRobot, mortals: TwoAgents, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []
    why = AgentRequests.why_silent

    def noting(
        self: AgentRequests, computer: str, limit: float, patience: float
    ) -> str:
        waited.append(limit - patience)
        return why(self, computer, limit, patience)

    monkeypatch.setattr(AgentRequests, "why_silent", noting)
    monkeypatch.setattr("poise.manage.agent_connections.agents.LOSS_DELAY", LIMIT)
    monkeypatch.setattr("poise.manage.migration.coordinator.DOWNTIME_LIMIT", 0.5)
    run = mortal.start("Counter")
    right = mortals.processes["right"]
    mortal.striking.before["pause"] = lambda: right.send_signal(signal.SIGSTOP)
    mortal.striking.before["roll back"] = lambda: right.send_signal(signal.SIGCONT)
    report = plan_move(run, "counter", "right").run()
    assert "the agent of 'right'" in report.reason
    assert waited
    assert min(waited) > 0  # no longer than for its answer, in all
    mortal.works()
    assert mortal.told("sink")[1] == 0


def test_a_caller_that_waits_no_longer_than_its_limit(world: MovingRobot) -> None:
    world.limit = 0.1
    run = world.start("Late")
    move_counter(run, "right")
    world.works()
    assert world.told("sink")[1] == 0
    assert world.told("source")[1] > 0


def test_what_a_manager_left_that_is_gone_is_ended_first(
    world: MovingRobot,
) -> None:
    """Else it would run on as it was, though it has other code or parameters by now."""

    def processes() -> set[int]:
        statuses = world.live.current().values()
        return {each.pid for status in statuses for each in status.containers}

    run = world.start("Counter")
    before = processes()
    placement, folder = run.placement(), str(world.folder)
    world.live = LiveRobot(run.robot, placement, run.agents, world.journal, folder)
    world.live.start()
    world.works()
    assert before
    assert before.isdisjoint(processes())
    told = [entry.what for entry in world.journal.entries()]
    assert any("stopping what an earlier manager left: " in what for what in told)


@pytest.mark.parametrize("source", ["left", "right"])
def test_a_chain_that_comes_back_to_its_caller_while_the_callee_moves(
    world: MovingRobot, source: str
) -> None:
    world.source = "Called"
    world.joints = (*JOINTS, ("counter.helps", "source.helps"))
    run = world.start("Calling", source)
    for target in ("right", "left", "right"):
        move_counter(run, target)
        world.works()
    assert world.wrong() == 0


def _ticker(folder: Path) -> ComponentEntry:
    code = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid()))"
    code += "; time.sleep(600)"
    command = ("python", "-c", code, str(folder / "pid"))
    return ComponentEntry(name="ticker", command=command)


def test_a_command_line_component_moves_by_a_cold_move(
    world: MovingRobot,
) -> None:
    world.extra = (_ticker(world.folder),)
    run = world.start("Counter")
    pid = world.folder / "pid"
    wait_until(lambda: pid.exists() and bool(pid.read_text()))
    before = pid.read_text()
    report = plan_move(run, "ticker", "right").run()
    assert (report.committed, report.reason) == (True, "")
    assert report.cold
    assert run.placement()["ticker"] == "right"
    wait_until(lambda: pid.read_text() not in {"", before})
    assert not Path("/proc", before).exists()
    world.works()
    assert world.wrong() == 0


def test_a_command_line_component_goes_on_when_it_cannot_start_elsewhere(
    world: MovingRobot,
) -> None:
    world.extra = (_ticker(world.folder),)
    run = world.start("Counter")
    pid = world.folder / "pid"
    wait_until(lambda: pid.exists() and bool(pid.read_text()))
    begin_deploy = world.striking.begin_deploy

    def refuse(computer: str, deployment: Deployment) -> PendingAnswer:
        goals = {
            component.goal
            for container in deployment.containers
            for component in container.components
            if component.name == "ticker"
        }
        if computer == "left" or goals != {"active"}:
            return begin_deploy(computer, deployment)
        reply = PendingAnswer()
        reply.set(Refused("not today"))
        return reply

    world.striking.begin_deploy = refuse
    report = plan_move(run, "ticker", "right").run()
    assert not report.committed
    assert "not today" in report.reason
    assert run.placement()["ticker"] == "left"
    wait_until(
        lambda: bool(pid.read_text()) and Path("/proc", pid.read_text()).exists()
    )
    world.works()


def test_of_two_equal_moves_the_second_says_where_it_is(world: MovingRobot) -> None:
    run = world.start("Counter")
    first, second = (plan_move(run, "counter", "right") for _ in range(2))
    assert first.run().committed
    report = second.run()
    assert not report.committed
    why = "component 'counter' was changed meanwhile: it runs on 'right' now"
    assert report.reason == why
    assert report.before == {"counter": "right"}


def test_refuses_what_cannot_be_moved(world: MovingRobot) -> None:
    run = world.start("Counter")
    with pytest.raises(UsageError, match="component 'nobody' is not running"):
        plan_move(run, "nobody", "right").run()
    with pytest.raises(UsageError, match="no computer 'nowhere'"):
        plan_move(run, "counter", "nowhere").run()
    with pytest.raises(UsageError, match="runs on 'left' already"):
        plan_move(run, "counter", "left").run()
