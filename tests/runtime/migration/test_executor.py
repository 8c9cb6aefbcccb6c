"""Steps to a container: their order, and those that come too late."""

from __future__ import annotations

import os
import time
from asyncio import CancelledError
from collections.abc import Iterator
from unittest.mock import Mock

import pytest
from msgspec import structs

from poise import Component
from poise.clock import SystemClock
from poise.errors import RunError
from poise.runtime.component.ports import Port
from poise.runtime.hosting.runner import Runner
from poise.runtime.hosting.wiring import Wiring
from poise.runtime.migration.executor import MigrationExecutor, Participant
from poise.wire.records.deployment_records import (
    ComponentSpec,
    ConnectorSpec,
    ContainerSpec,
)
from poise.wire.records.migration_records import (
    MigrationSteps,
    Step,
    StepsDone,
    StepsFailed,
    StepsOutcome,
)
from tests.waiting import LIMIT


class Nothing(Component):
    """Does nothing."""


@pytest.fixture
def runner() -> Iterator[Runner]:
    spec = ComponentSpec(name="one", goal="inactive")
    runner = Runner(spec, Nothing, SystemClock(), lambda: None)
    runner.start()
    runner.aim("active")
    assert runner.life_cycle.wait_state({"active", "failed"}, LIMIT) == "active"
    runner.gate.allow_pause()
    yield runner
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)


@pytest.fixture
def executor(runner: Runner) -> MigrationExecutor:
    return MigrationExecutor({("one", 0): runner}, Mock(), Mock())


OFFER, PAUSE, SEND, ROLL_BACK = (
    Step(name, "one", 0) for name in ("offer state", "pause", "send state", "roll back")
)


RESUME, HALT = Step("resume", "one", 0), Step("halt")
TOLD = ContainerSpec(
    name="container",
    folder="",
    components=(ComponentSpec(name="one", goal="active", leased=True),),
    connectors=(),
)


def batch(*steps: Step, migration: int = 1) -> MigrationSteps:
    return MigrationSteps(1, migration, "container", steps, LIMIT)


def is_at_work(runner: Runner) -> bool:
    """Return whether chains may enter it."""
    runner.exclusion.enter(7, LIMIT)
    runner.exclusion.leave()
    return True


def test_steps_of_the_migration_before_are_not_taken(
    executor: MigrationExecutor, runner: Runner
) -> None:
    late = executor.receive(batch(OFFER, PAUSE))
    executor.note_deployment(TOLD)  # it rolled back, and the next migration begins
    runner.gate.allow_pause()
    assert isinstance(executor.receive(batch(OFFER, migration=2))(), StepsDone)
    outcome = late()
    assert isinstance(outcome, StepsFailed)
    assert outcome.reason == "'offer state' was overtaken by a deployment"
    assert is_at_work(runner)


def test_a_source_is_not_resumed_by_the_migration_before(
    executor: MigrationExecutor, runner: Runner
) -> None:
    late = executor.receive(batch(ROLL_BACK))
    executor.note_deployment(TOLD)
    runner.gate.allow_pause()
    moving = batch(OFFER, PAUSE, SEND, migration=2)
    assert isinstance(executor.receive(moving)(), StepsDone)
    assert isinstance(late(), StepsFailed)
    with runner.gate.borrowed():  # it is, still
        pass


def test_a_step_of_an_older_migration_is_refused(executor: MigrationExecutor) -> None:
    executor.receive(batch(OFFER, migration=8))()
    outcome = executor.receive(batch(PAUSE, migration=7))()
    assert isinstance(outcome, StepsFailed)
    assert outcome.reason == (
        "component 'one': the step belongs to migration 7, and 8 has begun"
    )


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (
            (PAUSE,),
            "step 'pause' leads to phase 'quiesce', which may not follow 'start'",
        ),
        ((OFFER, SEND), "'send state' leads to phase 'transfer', which may not follow"),
        ((OFFER, PAUSE, ROLL_BACK, SEND), "which may not follow 'roll back'"),
    ],
)
def test_an_illegal_step_names_both_phases(
    executor: MigrationExecutor,
    runner: Runner,
    steps: tuple[Step, ...],
    words: str,
) -> None:
    outcome = executor.receive(batch(*steps))()
    assert isinstance(outcome, StepsFailed)
    assert words in outcome.reason
    assert is_at_work(runner)


def test_the_answer_says_which_steps_were_taken(executor: MigrationExecutor) -> None:
    outcome = executor.receive(batch(OFFER, PAUSE, SEND, ROLL_BACK))()
    assert isinstance(outcome, StepsDone)
    assert [(t.who, t.step, t.phase) for t in outcome.taken] == [
        ("one/0", "offer state", "prepare"),
        ("one/0", "pause", "quiesce"),
        ("one/0", "send state", "transfer"),
        ("one/0", "roll back", "roll back"),
    ]
    assert all(t.began <= t.ended for t in outcome.taken)


@pytest.mark.parametrize("raised", [SystemExit, CancelledError, RunError])
def test_the_answer_says_what_a_hook_raised(
    executor: MigrationExecutor,
    raised: type[BaseException],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    error = raised(os.fsdecode(b"no map-\xff.png"))
    monkeypatch.setattr(executor, "_act", Mock(side_effect=error))
    outcome = executor.receive(batch(OFFER))()
    assert isinstance(outcome, StepsFailed)
    assert r"no map-\udcff.png" in outcome.reason


def test_the_answer_says_in_which_step_a_hook_raised(
    executor: MigrationExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What code in C++ throws has no traceback that would say so."""
    monkeypatch.setattr(executor, "_act", Mock(side_effect=ValueError("too small")))
    outcome = executor.receive(batch(Step("restore state", "one", 0)))()
    assert isinstance(outcome, StepsFailed)
    assert outcome.reason.startswith("'restore state': ValueError: too small")


def test_code_that_lacks_a_port_takes_nobodys_place(runner: Runner) -> None:
    """The manager may commit before it hears that the port is not there."""
    wiring = Wiring(Mock())
    spec = ConnectorSpec(
        name="one.scan-other.scan",
        kind="local",
        source="one",
        source_port="scan",
        source_computer="here",
        target="other",
        target_port="scan",
        target_computer="here",
    )
    wiring.apply((spec,), {("one", 0): runner})
    executor = MigrationExecutor({("one", 0): runner}, wiring, Mock())
    outcome = executor.receive(batch(Step("pre-copy", "one", 0)))()
    assert isinstance(outcome, StepsFailed)
    assert "component 'one' has no port 'scan' that publishes" in outcome.reason


def test_code_with_another_port_takes_nobodys_place() -> None:
    runners = {
        ("one", epoch): Mock(ports={"scan": Port("scan", "publishes", type_)})
        for epoch, type_ in enumerate((str, int))
    }
    executor = MigrationExecutor(runners, Mock(), Mock())
    step = Step("pre-copy", "one", 1, sources={"one": (0, "")})
    outcome = executor.receive(batch(step))()
    assert isinstance(outcome, StepsFailed)
    assert outcome.reason.startswith("the types differ: 'one.scan' publishes int")


def test_activate_is_not_blamed_for_the_time_that_a_state_took() -> None:
    spec = ComponentSpec(name="one", goal="inactive")
    runner = Runner(spec, Nothing, SystemClock(), lambda: None)  # not started yet
    participant = Participant(runner, "target", 1, Mock())
    with pytest.raises(RunError, match="no time was left for `activate`"):
        participant.run(Step("activate", "one", 0), 0.0)
    with pytest.raises(RunError, match="`activate` has not ended after"):
        participant.run(Step("activate", "one", 0), time.monotonic() + 0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("left_after", "kind"), [(2, StepsDone), (1_000_000, StepsFailed)]
)
def test_a_release_waits_for_calls_at_the_former_target(
    left_after: int, kind: type[StepsOutcome]
) -> None:
    """Over a link that was cut they come late: the source must not end before."""
    looks = iter(range(1, left_after))
    wiring = Mock(with_messages=lambda names, _: set(names))
    wiring.sender_by_key.return_value.name = "calls"
    wiring.sender_by_key.return_value.has_left = lambda: not next(looks, 0)
    release = Step("release to targets", keys=("key",))
    steps = MigrationSteps(1, 1, "container", (release,), 0.05)
    outcome = MigrationExecutor({}, wiring, Mock()).receive(steps)()
    assert isinstance(outcome, kind)
    if isinstance(outcome, StepsFailed):
        assert "connector calls: a call has no answer yet" in outcome.reason
    wiring.sender_by_key.return_value.switch.assert_called_once_with("key")


def test_a_halt_says_that_nothing_was_committed_and_refuses_what_came_before(
    executor: MigrationExecutor, runner: Runner
) -> None:
    assert isinstance(executor.receive(batch(OFFER))(), StepsDone)
    late = executor.receive(batch(RESUME))
    assert not executor.halt(batch(HALT)).is_committed
    outcome = late()
    assert isinstance(outcome, StepsFailed)
    assert "'resume' was overtaken" in outcome.reason
    assert is_at_work(runner)


def test_a_halt_says_that_a_step_after_the_commit_was_begun(
    executor: MigrationExecutor,
) -> None:
    executor.receive(batch(RESUME))()
    assert executor.halt(batch(HALT)).is_committed
    assert executor.halt(batch(HALT)).is_committed  # as often as it is asked
    executor.note_deployment(TOLD)
    assert not executor.halt(batch(HALT)).is_committed


def test_a_halt_says_of_which_migration_the_last_step_was(
    executor: MigrationExecutor,
) -> None:
    first, second = (("component", 1),), (("component", 2),)
    executor.receive(structs.replace(batch(RESUME), targets=first))()
    done = executor.halt(batch(HALT))
    assert (done.targets, done.is_committed) == (first, True)
    executor.receive(structs.replace(batch(OFFER), targets=second))()
    done = executor.halt(batch(HALT))
    assert (done.targets, done.is_committed) == (second, False)


def test_the_end_of_a_lease_does_not_hide_that_a_step_after_the_commit_was_begun(
    executor: MigrationExecutor,
) -> None:
    executor.note_deployment(TOLD)
    executor.receive(batch(RESUME))()
    late = executor.receive(batch(RESUME))
    executor.note_deployment(TOLD.without_lease())
    assert isinstance(late(), StepsFailed)
    assert executor.halt(batch(HALT)).is_committed
    executor.note_deployment(TOLD)  # said again to one that another agent adopts
    assert executor.halt(batch(HALT)).is_committed


def test_over_a_cut_link_no_marker_is_sent_and_nobody_is_waited_for(
    runner: Runner,
) -> None:
    route = Mock()
    sender = Mock(routes=lambda: {"key": route})
    wiring = Mock(sender_by_key=lambda _: sender)
    executor = MigrationExecutor({("one", 0): runner}, wiring, Mock())
    outcome = executor.receive(batch(Step("buffer", lossy={"key": 3})))()
    assert isinstance(outcome, StepsDone)
    sender.buffer_for_move.assert_called_once_with(3)
    route.give_up.assert_called_once_with()
    sender.send_marker.assert_not_called()


def test_what_arrives_late_over_a_cut_link_is_taken_no_more(runner: Runner) -> None:
    wiring = Mock(with_messages=lambda names, _: set(names))
    executor = MigrationExecutor({("one", 0): runner}, wiring, Mock())
    drain = Step("drain channels", "one", 0, lossy={"key": 1})
    assert isinstance(executor.receive(batch(drain))(), StepsDone)
    wiring.shut.assert_called_once_with("key")


def test_a_pause_gives_up_what_the_component_sends_over_a_cut_link(
    runner: Runner, executor: MigrationExecutor
) -> None:
    """Else it waits for a component that waits for the computer that is cut off."""
    routes = {"cut": Mock(), "near": Mock()}
    senders = {
        name: Mock(routes=lambda name=name: {name: routes[name]}) for name in routes
    }
    runner.endpoints.senders.update(senders)
    pause = Step("pause", "one", 0, lossy={"cut": 1})
    outcomes = [executor.receive(batch(each))() for each in (OFFER, pause)]
    runner.endpoints.senders.clear()
    assert all(isinstance(each, StepsDone) for each in outcomes), outcomes
    routes["cut"].give_up.assert_called_once_with()
    routes["near"].give_up.assert_not_called()
    senders["cut"].send_marker.assert_not_called()
    senders["near"].send_marker.assert_called_once_with(1)
