"""The life of one component, and what happens when its code fails."""

from __future__ import annotations

import os
import sys
import threading
import time
from asyncio import CancelledError
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar

import pytest
from msgspec.structs import replace

from poise import Component, Message, Published, every, subscribed
from poise.clock import SystemClock
from poise.errors import RunError, Timeout
from poise.runtime._calls import PageSampler
from poise.runtime.execution.counters import Counts, StatsPage, new_memory
from poise.runtime.execution.exclusion import Redirected, new_chain
from poise.runtime.hosting import runner as runner_module
from poise.runtime.hosting.runner import Runner
from poise.wire.records.deployment_records import ComponentSpec
from poise.wire.records.status_records import State
from tests.waiting import wait_until

LIMIT = 20.0


class Note(Message):
    text: str


class Recorder(Component):
    """Writes down which of its code ran, and fails where its parameters say so."""

    def configure(self) -> None:
        self.told = threading.Condition()
        self.record: list[str] = []
        self._do("configure")

    def activate(self) -> None:
        self._do("activate")

    def deactivate(self) -> None:
        self._do("deactivate")

    def cleanup(self) -> None:
        self._do("cleanup")

    @subscribed(keep=5)
    def note(self, message: Note) -> None:
        self._do(message.text)

    def _do(self, what: str) -> None:
        with self.told:
            self.record.append(what)
            self.told.notify_all()
        if what == self.parameters.get("fail"):
            raise LookupError(f"{what} went wrong")
        if what == self.parameters.get("exit"):
            sys.exit(3)

    def wait_for(self, what: str) -> None:
        with self.told:
            assert self.told.wait_for(lambda: what in self.record, LIMIT)


class Ticking(Recorder):
    @every(0.001)
    def tick(self) -> None:
        self._do("tick")


class Fixture:
    """Starts components and ends them after the test."""

    def __init__(self) -> None:
        self._runners: list[Runner] = []

    def start(self, implementation: type[Component], **parameters: str) -> Runner:
        spec = ComponentSpec(
            name="one", goal="inactive", parameters=parameters, ends=("done",)
        )
        runner = Runner(spec, implementation, SystemClock(), lambda: None)
        self._runners.append(runner)
        runner.start()
        return runner

    def close(self) -> None:
        for runner in self._runners:
            runner.aim("finalized")
            assert runner.wait_ended(LIMIT)


@pytest.fixture
def running() -> Iterator[Fixture]:
    fixture = Fixture()
    yield fixture
    fixture.close()


def reach(runner: Runner, state: State) -> Recorder:
    runner.aim("inactive" if state == "failed" else state)  # type: ignore[arg-type]
    return _reached(runner, state)


def _reached(runner: Runner, state: State) -> Recorder:
    assert runner.life_cycle.wait_state({state, "failed"}, LIMIT) == state
    assert isinstance(runner.component, Recorder)
    return runner.component


def rest(runner: Runner, limit: float) -> None:
    runner.gate.allow_pause()
    runner.gate.pause_for_migration(limit)


def receive(runner: Runner, *texts: str) -> None:
    feed = runner.endpoints.mailbox.feed("note", Counts())
    for text in texts:
        feed.put((0, Note(text)))


def test_each_action_begins_once(running: Fixture) -> None:
    class Acting(Recorder):
        def begin(self, action: str) -> None:
            self._do(action)

    runner = running.start(Acting)
    component = reach(runner, "active")
    both = {2: "drive", 1: "look"}
    for actions in (both, both, {1: "look", 3: "drive on"}):
        runner.note_spec(replace(runner.spec, actions=actions))
        receive(runner, "then")
        component.wait_for([*actions.values()][-1])
    reach(runner, "finalized")
    begun = [what for what in component.record if what in {"look", *both.values()}]
    assert begun == ["drive", "look"]


def test_of_what_ends_an_action_the_first_counts(running: Fixture) -> None:
    class Acting(Recorder):
        done: Published[bool]

        def activate(self) -> None:
            self.done.publish(False)

        def begin(self, action: str) -> None:
            self.done.publish(action == "look")
            self.done.publish(action != "look")
            self._do(action)

    runner = running.start(Acting)
    component = reach(runner, "active")
    said = []
    for number, action in enumerate(("look", "drive")):
        runner.note_spec(replace(runner.spec, actions={number: action}))
        receive(runner, "then")
        component.wait_for(action)
        said += [end.done for end in runner.status().ends]
    assert said == [True, False]


def test_the_hooks_come_in_order(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    assert component.record == ["configure", "activate"]
    reach(runner, "inactive")
    reach(runner, "active")
    reach(runner, "finalized")
    assert component.record[2:] == [
        *("deactivate", "activate", "deactivate", "cleanup"),
    ]


def test_nothing_runs_before_it_is_active_and_after(running: Fixture) -> None:
    runner = running.start(Ticking)
    component = reach(runner, "inactive")
    receive(runner, "early")
    reach(runner, "active")
    component.wait_for("early")
    component.wait_for("tick")
    reach(runner, "inactive")
    at_rest = component.record.copy()
    assert at_rest[-1] == "deactivate"
    assert at_rest.index("early") > at_rest.index("activate")
    assert component.record == at_rest


def test_messages_come_in_order(running: Fixture) -> None:
    runner = running.start(Recorder)
    reach(runner, "active")
    receive(runner, "a", "b", "c")
    component = _reached(runner, "active")
    component.wait_for("c")
    assert component.record[2:] == ["a", "b", "c"]


@pytest.mark.parametrize("hook", ["configure", "activate"])
@pytest.mark.parametrize("how", ["fail", "exit"])
def test_a_hook_that_fails_ends_the_component(
    running: Fixture, hook: str, how: str
) -> None:
    runner = running.start(Recorder, **{how: hook})
    runner.aim("active")
    component = _reached(runner, "failed")
    assert runner.wait_ended(LIMIT)
    assert component.record[-2:] == [hook, "cleanup"]
    told = runner.status()
    assert told.state == "failed"
    assert f'_do("{hook}")' in told.error
    assert told.errors == 1


def test_a_handler_that_fails_is_counted_and_the_component_goes_on(
    running: Fixture,
) -> None:
    runner = running.start(Recorder, fail="bad")
    component = reach(runner, "active")
    receive(runner, "bad", "good")
    component.wait_for("good")
    told = runner.status()
    assert (told.state, told.errors) == ("active", 1)
    assert told.error.endswith("LookupError: bad went wrong")


def test_a_handler_may_raise_what_is_no_exception(running: Fixture) -> None:
    class Cancelled(Recorder):
        @subscribed(keep=5)
        def note(self, message: Note) -> None:
            self._do(message.text)
            if message.text == "bad":
                raise CancelledError

    runner = running.start(Cancelled)
    component = reach(runner, "active")
    receive(runner, "bad", "good")
    component.wait_for("good")
    assert (runner.status().state, runner.status().errors) == ("active", 1)


@pytest.mark.slow
@pytest.mark.parametrize("keep", [1, 5])
def test_a_message_that_came_as_it_was_deactivated_is_handled_later(
    running: Fixture, keep: int
) -> None:
    class Keeping(Recorder):
        @subscribed(keep=keep)
        def note(self, message: Note) -> None:
            self._do(message.text)

    runner = running.start(Keeping)
    component = reach(runner, "active")
    runner.exclusion.enter(new_chain(), LIMIT)
    receive(runner, "first")
    time.sleep(0.2)  # it was seen
    runner.aim("inactive")
    time.sleep(1.5)  # it no longer waits to enter
    runner.exclusion.leave()
    reach(runner, "inactive")
    assert "first" not in component.record
    reach(runner, "active")
    component.wait_for("first")
    receive(runner, "second")
    component.wait_for("second")


@pytest.mark.slow
def test_what_is_busy_when_it_is_deactivated_works_when_it_is_active_again(
    running: Fixture,
) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    runner.exclusion.enter(new_chain(), LIMIT)  # a call that takes long
    runner.aim("inactive")
    assert runner.life_cycle.wait_state({"inactive"}, 1.5) == "active"
    runner.exclusion.leave()
    reach(runner, "inactive")
    reach(runner, "active")
    receive(runner, "works")
    component.wait_for("works")


@pytest.mark.slow
def test_an_end_in_the_middle_of_a_call_is_a_bad_end(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    runner.exclusion.enter(new_chain(), LIMIT)  # a call that does not end
    reach(runner, "finalized")
    assert component.record[-2:] == ["deactivate", "cleanup"]
    assert runner.bad_end == "a call to component 'one' ran as it ended"


@pytest.mark.slow
def test_answers_are_taken_before_it_is_deactivated(running: Fixture) -> None:
    goes_on = threading.Event()

    class Asking(Recorder):
        def activate(self) -> None:
            call = self._context.calls.start(goes_on.wait, LIMIT)
            call.then(lambda _: self._do("answer"))
            self._do("activate")

    runner = running.start(Asking)
    component = reach(runner, "active")
    runner.aim("inactive")
    goes_on.set()
    reach(runner, "inactive")
    assert component.record[-2:] == ["answer", "deactivate"]
    page = StatsPage(new_memory())
    page.show({(runner.spec.name, runner.spec.epoch): runner}, ())
    read = page._sampler.read()
    assert read is not None
    assert read[2][0][4:] == (1, 1)  # asked for and done, as a message is


def test_a_timer_that_fails_goes_on_ticking(running: Fixture) -> None:
    runner = running.start(Ticking, fail="tick")
    component = reach(runner, "active")
    with component.told:
        component.told.wait_for(lambda: component.record.count("tick") > 3, LIMIT)
    assert runner.status().errors >= 3
    assert runner.status().timers[0].releases >= 3


def test_what_nothing_asked_for_is_no_job(running: Fixture) -> None:
    """The CPU time of one job is what all took, divided by what was asked for."""

    class Acting(Recorder):
        def begin(self, action: str) -> None:
            self._do(action)

    runner = running.start(Acting)
    memory = new_memory()
    StatsPage(memory).show({("one", 0): runner}, [])
    component = reach(runner, "active")
    runner.note_spec(replace(runner.spec, actions={1: "drive"}))
    receive(runner, "first")
    component.wait_for("drive")
    receive(runner, "second")
    component.wait_for("second")
    reach(runner, "inactive")
    read = PageSampler(memory, os.getpid()).read()
    assert read is not None
    [(*_, asked, done)] = read[2]
    assert (asked, done) == (2, 2)


def test_its_cpu_time_is_known_after_its_end(running: Fixture) -> None:
    class Busy(Component):
        def configure(self) -> None:
            sum(range(200_000))

    runner = running.start(Busy)
    runner.aim("finalized")
    assert runner.wait_ended(LIMIT)
    assert runner.status().cpu > 0.0


@pytest.mark.slow
def test_many_that_end_at_once_are_asked_how_they_are(running: Fixture) -> None:
    # a status must not ask for the CPU clock of a thread that is ending
    for _ in range(50):
        runner = running.start(Recorder, fail="configure")
        runner.aim("active")
        while runner.status().state != "failed":
            pass
        assert runner.status().cpu >= 0.0


def test_a_goal_that_is_told_again_waits_for_no_hook(running: Fixture) -> None:
    """Its container would not listen meanwhile, or end with all that it holds."""

    class Slow(Recorder):
        go_on: ClassVar = threading.Event()

        def activate(self) -> None:
            super().activate()
            assert self.go_on.wait(LIMIT)

    runner = running.start(Slow)
    component = reach(runner, "inactive")
    runner.aim("active")
    component.wait_for("activate")
    runner.aim("active")
    Slow.go_on.set()
    assert _reached(runner, "active") is component
    receive(runner, "works")
    component.wait_for("works")


def test_a_component_that_is_busy_does_not_come_to_rest(running: Fixture) -> None:
    class Slow(Recorder):
        go_on: ClassVar = threading.Event()

        @subscribed()
        def note(self, message: Note) -> None:
            super()._do(message.text)
            self.go_on.wait(LIMIT)

    runner = running.start(Slow)
    component = reach(runner, "active")
    receive(runner, "a")
    component.wait_for("a")
    with pytest.raises(Timeout, match=r"component 'one' did not pause .*: 'note' runs"):
        rest(runner, 0.01)
    Slow.go_on.set()
    rest(runner, LIMIT)
    runner.gate.resume()


def test_is_idle_when_all_that_waits_was_worked_on(running: Fixture) -> None:
    class Slow(Recorder):
        go_on: ClassVar = threading.Semaphore(0)

        @subscribed(block=5)
        def note(self, message: Note) -> None:
            super()._do(message.text)
            self.go_on.acquire(timeout=LIMIT)

    runner = running.start(Slow)
    component = reach(runner, "active")
    receive(runner, "a", "b")
    component.wait_for("a")
    with ThreadPoolExecutor(1) as waiter:
        idle = waiter.submit(runner.gate.wait_idle, LIMIT)
        wait_until(lambda: runner.gate._awaited_idle is not None)
        Slow.go_on.release()
        component.wait_for("b")
        assert not idle.done()
        Slow.go_on.release()
        assert idle.result(LIMIT)


def test_idleness_is_not_waited_for_longer_than_its_limit(running: Fixture) -> None:
    runner = running.start(Recorder)
    reach(runner, "active")
    assert not runner.gate.wait_idle(0.01)


def test_waiting_for_marks_has_a_limit(running: Fixture) -> None:
    runner = running.start(Recorder)
    reach(runner, "active")
    runner.endpoints.note_marker("somebody", 7)
    runner.endpoints.wait_markers({"somebody": 7}, LIMIT)
    with pytest.raises(Timeout, match="still under way over somebody"):
        runner.endpoints.wait_markers({"somebody": 8}, 0.01)


def test_measures_are_summed_up(running: Fixture) -> None:
    class Measuring(Component):
        def configure(self) -> None:
            for value in (1.0, 2.0, 6.0):
                self.measure("size", value)

    runner = running.start(Measuring)
    runner.aim("inactive")
    runner.life_cycle.wait_state({"inactive"}, LIMIT)
    summary = runner.status().measures["size"]
    assert (summary.count, summary.mean, summary.maximum) == (3, 3.0, 6.0)


def test_measures_whose_names_are_ever_others_do_not_fill_the_memory(
    running: Fixture, caplog: pytest.LogCaptureFixture
) -> None:
    class Measuring(Component):
        def configure(self) -> None:
            for number in range(300):
                self.measure(f"object {number}", 1.0)
                self.measure("object 0", 1.0)

    runner = running.start(Measuring)
    runner.aim("inactive")
    runner.life_cycle.wait_state({"inactive"}, LIMIT)
    measures = runner.status().measures
    assert len(measures) == 100
    assert measures["object 0"].count == 301
    (said,) = caplog.messages
    assert said.startswith("measure 'object 100' of component 'one' is not counted")


def test_a_pause_that_comes_after_the_move_is_refused(
    running: Fixture,
) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    runner.gate.allow_pause()
    runner.aim("active")  # the move is over
    with pytest.raises(RunError, match="component 'one' does not move"):
        runner.gate.pause_for_migration(LIMIT)
    receive(runner, "a")
    component.wait_for("a")


def test_a_pause_that_waits_ends_with_the_move(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    runner.gate.allow_pause()
    runner.exclusion.enter(7, LIMIT)
    with ThreadPoolExecutor() as pool:
        late = pool.submit(runner.gate.pause_for_migration, LIMIT)
        runner.aim("active")
        runner.exclusion.leave()
        with pytest.raises(RunError, match="does not move"):
            late.result(LIMIT)
    receive(runner, "a")
    component.wait_for("a")


def test_a_pause_that_waits_ends_with_its_own_move(
    running: Fixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    pause = runner.gate.pause

    def meanwhile(limit: float) -> None:
        runner.aim("active")
        runner.gate.allow_pause()  # for the next move
        pause(limit)

    monkeypatch.setattr(runner.gate, "pause", meanwhile)
    with pytest.raises(RunError, match="does not move"):
        rest(runner, LIMIT)
    receive(runner, "a")
    component.wait_for("a")


def test_goes_on_after_its_code_ran_at_rest(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    rest(runner, LIMIT)
    with runner.gate.borrowed():  # a snapshot, say
        runner.aim("active")  # does not wait for it
        runner.gate.allow_pause()  # nor for the next move
        receive(runner, "a")
        with pytest.raises(Timeout):
            runner.exclusion.enter(7, 0.05)
    component.wait_for("a")


def test_stays_at_rest_after_its_code_ran_there(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "active")
    rest(runner, LIMIT)
    with runner.gate.borrowed():
        runner.aim("active")
        rest(runner, LIMIT)  # for the next move
    receive(runner, "a")
    with pytest.raises(Timeout):
        runner.exclusion.enter(7, 0.05)
    assert "a" not in component.record


def test_what_is_ready_does_nothing_before_it_is_active(running: Fixture) -> None:
    runner = running.start(Ticking)
    runner.aim("ready")
    component = _reached(runner, "active")
    receive(runner, "a")
    with pytest.raises(Timeout):
        runner.exclusion.enter(7, 0.05)
    assert component.record == ["configure", "activate"]
    runner.aim("active")
    component.wait_for("a")


@pytest.mark.slow
def test_one_that_is_wanted_again_while_callers_stay_inside_goes_on(
    running: Fixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_PATIENCE", 0.02)
    runner = running.start(Recorder)
    component = reach(runner, "active")
    runner.exclusion.enter(new_chain(), LIMIT)
    runner.aim("inactive")
    time.sleep(0.05)
    runner.aim("active")
    wait_until(lambda: runner.life_cycle.is_at_work)
    time.sleep(0.05)
    runner.exclusion.leave()
    receive(runner, "still here")
    component.wait_for("still here")
    assert "deactivate" not in component.record


def test_one_whose_callers_stay_inside_fails_and_says_so(
    running: Fixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "_PATIENCE", 0.02)
    monkeypatch.setattr(runner_module, "_BUSY_LIMIT", 0.05)
    runner = running.start(Recorder)
    reach(runner, "active")
    runner.exclusion.enter(new_chain(), LIMIT)
    reach(runner, "failed")
    assert "did not pause" in runner.status().error


def test_what_has_ended_does_not_begin_again(running: Fixture) -> None:
    runner = running.start(Recorder)
    component = reach(runner, "inactive")
    runner.aim("finalized")
    runner.aim("active")  # an order that comes late
    assert runner.wait_ended(LIMIT)
    assert component.record == ["configure", "cleanup"]


def test_callers_that_wait_are_sent_away_when_it_ends(running: Fixture) -> None:
    runner = running.start(Recorder)
    reach(runner, "active")
    rest(runner, LIMIT)
    with ThreadPoolExecutor() as pool:
        caller = pool.submit(runner.exclusion.enter, 7, LIMIT)
        runner.aim("finalized")
        with pytest.raises(Redirected):
            caller.result(LIMIT)


def test_nobody_takes_a_snapshot_of_what_works(running: Fixture) -> None:
    runner = running.start(Recorder)
    reach(runner, "active")
    with pytest.raises(RunError, match="is not paused"), runner.gate.borrowed():
        pass
