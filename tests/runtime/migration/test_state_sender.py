"""A target goes on where the source stopped."""

from __future__ import annotations

import threading
from asyncio import CancelledError
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Protocol
from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from poise import Component, Message, Provided, Published, every, oneway, subscribed
from poise.clock import SystemClock
from poise.errors import Timeout, UsageError
from poise.runtime.connectors.interface import methods
from poise.runtime.connectors.latest import Heard
from poise.runtime.execution.counters import Counts
from poise.runtime.execution.data_age import Stamped
from poise.runtime.hosting import output
from poise.runtime.hosting.checkpoints import Checkpoints
from poise.runtime.hosting.output import OutputFile, read_output
from poise.runtime.hosting.outside_requests import OutsideRequests
from poise.runtime.hosting.runner import Runner
from poise.runtime.migration.state_check import describe_type
from poise.runtime.migration.state_transfer import (
    Request,
    StateSender,
    StateTransfer,
    fetch,
    restore,
)
from poise.wire import frame
from poise.wire.codec import codec, pack
from poise.wire.connections.channel import Channel
from poise.wire.frame import Frame, FrameKind, Pieces
from poise.wire.records.deployment_records import ChainPart, ComponentSpec
from poise.wire.records.request_records import PARAMETERS, PortRequest, ReadOutput
from tests.waiting import wait_until

LIMIT = 20.0
BOOK = ComponentSpec(name="book", goal="inactive")


class Notes(Message):
    texts: tuple[str, ...]


class Tells(Protocol):
    @oneway
    def tell(self, text: str) -> None: ...


class Book(Component):
    """Has a state, a topic, one-way calls and a timer."""

    tells: Provided[Tells]

    def configure(self) -> None:
        self.texts: tuple[str, ...] = ()

    @every(1000.0)
    def tick(self) -> None: ...

    @subscribed(block=2)
    def notes(self, message: Notes) -> None:
        self.texts += message.texts

    def tell(self, text: str) -> None:
        self.texts += (text,)

    def snapshot(self) -> Notes:
        return Notes(self.texts)

    def restore(self, state: Notes) -> None:
        self.texts = state.texts


class Gradual(Book):
    """Hands over what changed since it was asked last."""

    def snapshot(self) -> Notes:
        self.given = len(self.texts)
        return super().snapshot()

    def snapshot_delta(self) -> Notes:
        return Notes(self.texts[self.given :])

    def restore_delta(self, delta: Notes) -> None:
        self.texts += delta.texts


class Forgetful(Gradual):
    """Takes a change for given once it was asked for it."""

    def snapshot_delta(self) -> Notes:
        delta = super().snapshot_delta()
        self.given = len(self.texts)
        return delta


class Untyped(Book):
    def restore(self, state) -> None:  # type: ignore[no-untyped-def] # noqa: ANN001
        self.texts = state.texts


class Counted(Message):
    count: int


class Counting(Book):
    def restore(self, state: Counted) -> None:  # type: ignore[override]
        self.texts = ("?",) * state.count


class Unsaid(Exception):
    def __str__(self) -> str:
        raise RuntimeError("it says nothing")


class Quitting(Book):
    raises: type[BaseException]

    def snapshot(self) -> Notes:
        raise self.raises


def adapt(old: Notes) -> Counted:
    return Counted(len(old.texts))


class DirectPipe(Channel):
    """Asks the old incarnation on the thread of the new."""

    def __init__(self, runner: Runner) -> None:
        server = Mock()
        self.sender = StateSender(runner, 1, server)
        _, self._serve = server.open.call_args.args

    def try_connect(self) -> bool:
        return True

    def is_calling(self) -> bool:
        return False

    def request(self, pieces: Pieces, limit: float) -> Frame:  # noqa: ARG002, it is here
        return frame.parse(b"".join(self._serve(frame.parse(b"".join(pieces)))))


class Incarnations:
    """An old incarnation at work, and new ones that take over."""

    def __init__(self) -> None:
        self._runners: list[Runner] = []

    def start(
        self,
        implementation: type[Component],
        *,
        active: bool,
        spec: ComponentSpec = BOOK,
        checkpoints: Checkpoints | None = None,
    ) -> Runner:
        runner = Runner(spec, implementation, SystemClock(), lambda: None)
        runner.checkpoints = checkpoints
        self._runners.append(runner)
        runner.start()
        runner.aim("active" if active else "inactive")
        runner.life_cycle.wait_state({"active" if active else "inactive"}, LIMIT)
        return runner

    def close(self) -> None:
        for runner in self._runners:
            runner.aim("finalized")
            assert runner.wait_ended(LIMIT)


@pytest.fixture
def incarnations() -> Iterator[Incarnations]:
    made = Incarnations()
    yield made
    made.close()


def texts(runner: Runner) -> tuple[str, ...]:
    assert isinstance(runner.component, Book)
    return runner.component.texts


def rest(runner: Runner) -> DirectPipe:
    runner.gate.allow_pause()
    runner.gate.pause_for_migration(LIMIT)
    channel = DirectPipe(runner)
    channel.sender.send()
    return channel


def tell(runner: Runner, *words: str) -> None:
    """Let the component hear something, as if over a connector."""
    runner.exclusion.enter(1, LIMIT)
    assert isinstance(runner.component, Book)
    for word in words:
        runner.component.tell(word)
    runner.exclusion.leave()


def test_state_and_timers_go_over(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=False)
    old.timers.begin_at({"tick": old.clock.now() + 300.0})
    old.aim("active")
    old.life_cycle.wait_state({"active"}, LIMIT)
    new = incarnations.start(Book, active=False)
    tell(old, "a", "b")
    channel = rest(old)
    restore(new, fetch(channel, Request.ALL, LIMIT))
    new.aim("ready")
    new.life_cycle.wait_state({"active"}, LIMIT)
    assert texts(new) == ("a", "b")
    # the time for which the answer was under way is all by which the phase may shift
    assert new.timers.next_due() == pytest.approx(old.timers.next_due(), abs=5)


def test_what_it_writes_about_its_state_is_its_own(
    incarnations: Incarnations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It had the name of its container, and `poise log COMPONENT` did not show it."""
    monkeypatch.setattr(output, "_BEING_WRITTEN", 0)
    monkeypatch.setattr(output, "_here", threading.local())
    log = OutputFile(tmp_path, "hall")

    class Talkative(Book):
        def snapshot(self) -> Notes:
            log.add("given")
            return super().snapshot()

        def restore(self, state: Notes) -> None:
            log.add("taken")
            super().restore(state)

    old, new = (incarnations.start(Talkative, active=a) for a in (True, False))
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    log.add("by nobody")
    written = read_output(tmp_path, ReadOutput(component="", after=0, most=9)).lines
    assert [(line.component, line.text) for line in written] == [
        ("book", "given"),
        ("book", "taken"),
        ("hall", "by nobody"),
    ]


class Acting(Book):
    """Says that its action is done, each time that it is told to begin or activated."""

    done: Published[bool]

    def activate(self) -> None:
        self.done.publish(True)

    def begin(self, action: str) -> None:
        self.texts += (action,)
        self.tasks.start("next")
        self.done.publish(True)


def test_what_it_was_told_and_says_of_tasks_goes_over(
    incarnations: Incarnations,
) -> None:
    """The manager may hear it from the target alone, and not twice."""
    spec = replace(BOOK, ends=("done",), actions={7: "look"})
    old = incarnations.start(Acting, active=True, spec=replace(spec, goal="active"))
    new = incarnations.start(Acting, active=False, spec=spec)
    wait_until(lambda: texts(old) == ("look",))
    wait_until(lambda: old.status().task_requests)
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    new.aim("active")
    new.life_cycle.wait_state({"active"}, LIMIT)
    assert (texts(new), new.begun) == (("look",), {7})
    assert new.status().ends == old.status().ends
    assert new.status().task_requests == old.status().task_requests


def test_an_action_that_begins_amid_a_move_is_told_to_the_target_only(
    incarnations: Incarnations,
) -> None:
    spec = replace(BOOK, ends=("done",), actions={7: "look"})
    old = incarnations.start(Acting, active=True, spec=replace(spec, goal="active"))
    wait_until(lambda: texts(old) == ("look",))
    spec = replace(spec, actions={7: "look", 8: "go"})
    new = incarnations.start(Acting, active=False, spec=spec)
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    new.aim("active")
    wait_until(lambda: texts(new) == ("look", "go"))


@pytest.mark.parametrize(
    ("fresh", "state", "kept"),
    [(False, ("a",), {"a-b": (1, 5)}), (False, (), {}), (True, ("a",), {})],
)
def test_with_its_state_goes_what_it_has_heard(
    incarnations: Incarnations,
    fresh: bool,  # noqa: FBT001, a parameter
    state: tuple[str, ...],
    kept: Heard,
) -> None:
    """Else it needs the last messages again."""
    new = incarnations.start(Book, active=False, spec=replace(BOOK, fresh=fresh))
    given = StateTransfer(heard={"notes": {"a-b": (1, 5)}})
    if state:
        pieces = frame.segments(codec(Notes), Notes(state), FrameKind.MESSAGE)
        said = describe_type(Notes)
        given = replace(given, state=b"".join(pieces), state_type=said)
    restore(new, given)
    assert new.endpoints.heard["notes"] == kept
    assert texts(new) == (() if fresh else state)


def test_data_that_the_target_makes_next_is_as_old_as_what_the_source_took(
    incarnations: Incarnations,
) -> None:
    spec = replace(BOOK, chains=(ChainPart(name="c"),))
    old = incarnations.start(Book, active=True, spec=replace(spec, goal="active"))
    new = incarnations.start(Book, active=False, spec=spec)
    took = old.clock.now() - 5.0
    old.ages.restore({"c": old.clock.stamp(took)})
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    assert new.ages.local(new.ages.held()["c"]) == pytest.approx(took, abs=1e-3)


def test_what_waits_goes_over_in_order(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Book, active=False)
    channel = rest(old)
    feed = old.endpoints.mailbox.feed("notes", Counts())
    for number in range(5):  # more than there is room for while it works
        feed.put((0, Notes((str(number),))))
    restore(new, fetch(channel, Request.ALL, LIMIT))
    assert [v.texts for _, (_, v) in new.endpoints.mailbox.waiting()] == [
        (str(number),) for number in range(5)
    ]


def test_one_way_calls_that_wait_go_over_in_order(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Book, active=False)
    channel = rest(old)
    tag = next(iter(methods(Tells)))
    feed = old.endpoints.mailbox.feed("tells", Counts())
    for word in ("a", "b"):
        feed.put((tag, (word,)))
    restore(new, fetch(channel, Request.ALL, LIMIT))
    new.aim("active")
    wait_until(lambda: texts(new) == ("a", "b"))


def test_says_when_a_state_that_is_copied_ahead_takes_too_long(
    incarnations: Incarnations,
) -> None:
    """That no target requested it was all that was said: it was on its way."""
    old = incarnations.start(Gradual, active=True)
    channel = DirectPipe(old)
    with pytest.raises(Timeout, match="no target requested the state of component"):
        channel.sender.wait_requested(0.0)
    fetch(channel, Request.STATE, LIMIT)
    with pytest.raises(Timeout, match="was not copied ahead within 0 s: is it too lar"):
        channel.sender.wait_requested(0.0)


def test_a_large_state_goes_first_and_then_what_changed(
    incarnations: Incarnations,
) -> None:
    old = incarnations.start(Gradual, active=True)
    new = incarnations.start(Gradual, active=False)
    tell(old, "a")
    channel = DirectPipe(old)
    restore(new, fetch(channel, Request.STATE, LIMIT))
    assert texts(new) == ("a",)
    tell(old, "b")
    old.gate.allow_pause()
    old.gate.pause_for_migration(LIMIT)
    channel.sender.send()
    given = fetch(channel, Request.ALL, LIMIT)
    assert not given.state
    restore(new, given)
    assert texts(new) == ("a", "b")


@pytest.mark.slow
def test_a_checkpoint_takes_no_change_from_what_is_still_to_be_sent(
    incarnations: Incarnations, tmp_path: Path
) -> None:
    """Its `snapshot` would be the last one, since which `snapshot_delta` counts."""
    checkpoints = Checkpoints(tmp_path, "book", 1, 0.01, SystemClock())
    old = incarnations.start(Gradual, active=True, checkpoints=checkpoints)
    new = incarnations.start(Gradual, active=False)
    channel = DirectPipe(old)
    restore(new, fetch(channel, Request.STATE, LIMIT))
    tell(old, "a")
    first = checkpoints.due
    wait_until(lambda: checkpoints.due > first + 0.05)
    old.gate.allow_pause()
    old.gate.pause_for_migration(LIMIT)
    channel.sender.send()
    restore(new, fetch(channel, Request.ALL, LIMIT))
    assert texts(new) == ("a",)


@pytest.mark.slow
def test_checkpoints_go_on_when_a_move_led_back(
    incarnations: Incarnations, tmp_path: Path
) -> None:
    checkpoints = Checkpoints(tmp_path, "book", 1, 0.01, SystemClock())
    old = incarnations.start(Gradual, active=True, checkpoints=checkpoints)
    fetch(DirectPipe(old), Request.STATE, LIMIT)
    tell(old, "a word")
    old.aim("active")
    wait_until(lambda: any(b"a word" in f.read_bytes() for f in _kept(tmp_path)))


@pytest.mark.slow
def test_what_came_by_a_move_is_kept_at_once(
    incarnations: Incarnations, tmp_path: Path
) -> None:
    """What the source had kept is removed, and the interval may be long."""
    old = incarnations.start(Book, active=True)
    new = incarnations.start(
        Book,
        active=False,
        checkpoints=Checkpoints(tmp_path, "book", 2, 1000.0, SystemClock()),
    )
    tell(old, "a word")
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    new.aim("active")
    wait_until(lambda: any(b"a word" in f.read_bytes() for f in _kept(tmp_path)))


def _kept(folder: Path) -> list[Path]:
    return [*folder.glob("*.checkpoint")]


def test_new_code_that_copies_ahead_gets_all_from_old_code_that_does_not(
    incarnations: Incarnations,
) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Gradual, active=False)
    channel = DirectPipe(old)
    restore(new, fetch(channel, Request.STATE, LIMIT))
    tell(old, "a")
    old.gate.allow_pause()
    old.gate.pause_for_migration(LIMIT)
    channel.sender.send()
    restore(new, fetch(channel, Request.ALL, LIMIT))
    assert texts(new) == ("a",)


class Fewer(Component):
    """Is like a book, without the ports that nobody uses."""

    def restore(self, state: Notes) -> None:
        self.texts = state.texts


def test_new_code_may_lack_ports_that_nobody_uses(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Fewer, active=False)
    tell(old, "a")
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    assert isinstance(new.component, Fewer)
    assert new.component.texts == ("a",)


class Tuned(Book):
    """Counts how often it is tuned."""

    def configure(self) -> None:
        super().configure()
        self.gains: list[float] = []

    def reconfigure(self, parameters: Mapping[str, float]) -> None:
        self.gains.append(parameters["gain"])


def test_what_was_set_a_moment_before_a_move_goes_over(
    incarnations: Incarnations,
) -> None:
    """The deployment of the new incarnation does not say so yet."""
    spec = ComponentSpec(name="book", goal="inactive", parameters={"gain": 1.0})
    old = incarnations.start(Tuned, active=True, spec=spec)
    new = incarnations.start(Tuned, active=False, spec=spec)
    answers: list[object] = []
    outside = OutsideRequests(lambda _: old, answers.append)
    request = PortRequest(
        number=1,
        container="",
        component="book",
        port=PARAMETERS,
        method="set",
        value=pack(((), {"gain": 2.0})),
        limit=LIMIT,
    )
    outside.take(request)
    wait_until(lambda: answers)
    restore(new, fetch(rest(old), Request.ALL, LIMIT))
    new.aim("active")
    assert isinstance(new.component, Tuned)
    gains = new.component.gains

    def is_told(parameters: Mapping[str, float]) -> bool:
        return new._changed_parameters == parameters

    wait_until(lambda: gains == [2.0])
    for gain in (1.5, 2.0):  # what was set elsewhere before, then what was set here
        changed = {"gain": gain}
        new.note_spec(replace(spec, changed_parameters=changed))
        new.aim("active")
        wait_until(partial(is_told, changed))
    assert (gains, new.parameters_set) == ([2.0], {})
    assert new.component.parameters == {"gain": 2.0}


def test_what_works_gives_only_its_state(incarnations: Incarnations) -> None:
    """As when the new one asks after the move led back."""
    channel = DirectPipe(incarnations.start(Book, active=True))
    channel.sender.send()
    with pytest.raises(UsageError, match="RunError: component 'book' is not paused"):
        fetch(channel, Request.ALL, LIMIT)


def test_another_implementation_takes_the_adapted_state(
    incarnations: Incarnations,
) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Counting, active=False)
    tell(old, "a", "b")
    restore(new, fetch(rest(old), Request.ALL, LIMIT), adapt)
    assert texts(new) == ("?", "?")


@pytest.mark.parametrize("made", [None, 5, Counted("two")])  # type: ignore[arg-type]
def test_adapt_must_return_what_it_says(
    incarnations: Incarnations, made: object
) -> None:
    def falsely(_notes: Notes) -> Counted:
        return made  # type: ignore[return-value]

    old = incarnations.start(Book, active=True)
    new = incarnations.start(Counting, active=False)
    with pytest.raises(UsageError, match="falsely returned is not Counted: Expected"):
        restore(new, fetch(rest(old), Request.ALL, LIMIT), falsely)


def test_adapt_must_take_an_argument(incarnations: Incarnations) -> None:
    def lonely() -> Counted:
        return Counted(0)

    old = incarnations.start(Book, active=True)
    new = incarnations.start(Counting, active=False)
    with pytest.raises(UsageError, match="lonely must take one argument: the state"):
        restore(new, fetch(rest(old), Request.ALL, LIMIT), lonely)  # type: ignore[arg-type]


def test_restore_must_say_the_type_of_the_state(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Untyped, active=False)
    given = fetch(rest(old), Request.ALL, LIMIT)
    with pytest.raises(UsageError, match="'state' must say the state's type"):
        restore(new, given)


@pytest.mark.parametrize("raised", [SystemExit, CancelledError, Unsaid])
def test_whoever_asks_hears_what_a_snapshot_raises(
    incarnations: Incarnations, raised: type[BaseException]
) -> None:
    code = type("Quitting", (Quitting,), {"raises": raised})
    old = incarnations.start(code, active=True)
    with pytest.raises(UsageError, match=f"the snapshot failed: {raised.__name__}"):
        fetch(rest(old), Request.ALL, LIMIT)


def test_a_request_is_not_answered_for_ever(incarnations: Incarnations) -> None:
    channel = DirectPipe(incarnations.start(Book, active=True))
    with pytest.raises(UsageError, match="Timeout: component 'book' is not ready"):
        fetch(channel, Request.ALL, 0.0)


def test_a_request_whose_answer_got_lost_gets_it_again(
    incarnations: Incarnations,
) -> None:
    """For `snapshot_delta` gives each change once."""
    old = incarnations.start(Forgetful, active=True)
    channel = DirectPipe(old)
    fetch(channel, Request.STATE, LIMIT)
    tell(old, "a")
    old.gate.allow_pause()
    old.gate.pause_for_migration(LIMIT)
    channel.sender.send()
    lost = fetch(channel, Request.ALL, LIMIT)
    assert fetch(channel, Request.ALL, LIMIT).delta == lost.delta


def test_a_state_is_not_kept_when_the_move_led_back(
    incarnations: Incarnations,
) -> None:
    """It may be large, and is old as soon as the component works again."""
    old = incarnations.start(Book, active=True)
    channel = rest(old)
    before = fetch(channel, Request.ALL, LIMIT)
    channel.sender.refuse("it is at work again")
    old.aim("active")
    tell(old, "a")
    old.gate.allow_pause()
    old.gate.pause_for_migration(LIMIT)
    channel.sender.send()
    assert fetch(channel, Request.ALL, LIMIT).state != before.state


def test_whoever_asks_waits_until_it_is_given(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    tell(old, "a")
    channel = DirectPipe(old)
    with ThreadPoolExecutor(1) as asker:
        asked = asker.submit(fetch, channel, Request.ALL, LIMIT)
        old.gate.allow_pause()
        old.gate.pause_for_migration(LIMIT)
        assert not asked.done()
        channel.sender.send()
        assert asked.result(LIMIT).state


def test_whoever_asks_hears_why_nothing_is_given(incarnations: Incarnations) -> None:
    channel = DirectPipe(incarnations.start(Book, active=True))
    channel.sender.refuse("it did not come to rest")
    with pytest.raises(UsageError, match="it did not come to rest"):
        fetch(channel, Request.ALL, LIMIT)


def test_what_waits_goes_over_with_its_stamps(incarnations: Incarnations) -> None:
    old = incarnations.start(Book, active=True)
    new = incarnations.start(Book, active=False)
    channel = rest(old)
    feed = old.endpoints.mailbox.feed("notes", Counts())
    feed.put((0, Stamped(("c",), (5.0,), Notes(("a",)))))
    restore(new, fetch(channel, Request.ALL, LIMIT))
    ((_, (_, found)),) = new.endpoints.mailbox.waiting()
    assert (found.chains, found.value.texts) == (("c",), ("a",))
    assert found.stamps == pytest.approx((5.0,), abs=1e-3)
