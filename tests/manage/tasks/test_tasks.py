"""Several tasks at once: what runs now, what ends it, and who waits for whom. Pure."""

from __future__ import annotations

import contextlib

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from poise.errors import UsageError
from poise.manage.tasks.concurrent_tasks import MOST_OVER, Tasks
from poise.manage.tasks.task_progress import Saved, TaskRecord
from poise.manage.tasks.task_reports import OVER
from poise.model.phases import clashes
from poise.model.robot import Architecture, ComponentEntry, Computer, Device, Robot
from poise.model.steps import (
    Action,
    Choice,
    Parallel,
    Repeat,
    Retry,
    Sequence,
    Step,
    Subtask,
    Task,
    Until,
)

FUNCTIONS = ("see", "drive", "talk", "grasp", "push")
WITH_ARM = {"grasp", "push"}


def act(name: str, *functions: str, **more: object) -> Action:
    return Action(name=name, functions=functions or ("see",), **more)  # type: ignore[arg-type] # of a test


def robot_with(*tasks: Task) -> Robot:
    """Return a robot with these tasks, an exclusive arm and an exclusive voice."""
    return Robot(
        name="r",
        computers=(Computer(name="main", capacity={"cpu": 1.0, "memory": 1e9}),),
        devices=(Device(name="arm", computer="main", exclusive=True),),
        architectures=tuple(
            Architecture(
                name=f"{function}-arch",
                function=function,
                exclusive=function == "talk",
                components=(
                    ComponentEntry(
                        name=f"{function}er",
                        devices=("arm",) if function in WITH_ARM else (),
                    ),
                ),
            )
            for function in FUNCTIONS
        ),
        tasks=tasks,
    )


def task(name: str, *steps: Step, priority: int = 0) -> Task:
    return Task(name=name, actions=steps, priority=priority)


class Played:
    """Tasks whose actions a test ends."""

    def __init__(self, *tasks: Task, chosen: int = 0) -> None:
        self.said: list[str] = []
        self.robot = robot_with(*tasks)
        self.tasks = Tasks(self.robot, self.said.append, lambda *_: chosen)
        self.now = 0.0
        for each in tasks:
            self.tasks.start(each.name, self.now)
        self.work()

    def work(self) -> None:
        """Let all that may run work."""
        self.tasks.arbitrate(self.now)
        for record in self.tasks.going():
            for each in self.tasks.tries(record):
                self.tasks.began(each.number, self.now)

    def names(self) -> list[str]:
        """Return the actions that may run, with all tasks."""
        return [t.name for r in self.tasks.going() for t in self.tasks.tries(r)]

    def end(self, name: str, *, done: bool = True) -> list[str]:
        """End an action; return those that run then."""
        (number,) = (
            t.number
            for r in self.tasks.going()
            for t in self.tasks.tries(r)
            if t.name == name
        )
        self.tasks.end(number, self.now, "told", done=done)
        self.work()
        return self.names()

    def after(self, seconds: float, *holding: str) -> list[str]:
        """Let time pass; return the actions that run then."""
        self.now += seconds
        self.tasks.end_due(self.now, lambda until: until.when in holding)
        self.work()
        return self.names()

    def states(self) -> dict[str, str]:
        return {r.name: r.state for r in self.tasks.records}


def test_steps_come_one_after_another_and_then_the_task_is_done() -> None:
    played = Played(task("t", act("a"), act("b", "drive")))
    assert played.names() == ["a"]
    assert played.tasks.functions_of(played.tasks.going()) == {"see"}
    assert played.end("a") == ["b"]
    assert played.tasks.functions_of(played.tasks.going()) == {"drive"}
    assert played.end("b") == []
    assert played.states() == {"t": "done"}


def test_steps_in_parallel_are_done_when_all_are() -> None:
    both = Parallel(steps=(act("a"), act("b", "drive")))
    played = Played(task("t", both, act("c")))
    assert played.names() == ["a", "b"]
    assert played.end("b") == ["a"]
    assert played.end("a") == ["c"]


def test_one_that_fails_ends_the_others_in_parallel_and_the_task_says_why() -> None:
    both = Parallel(steps=(act("a"), act("b", "drive")))
    played = Played(task("t", both, act("c")))
    assert played.end("b", done=False) == []
    (record,) = played.tasks.records
    assert (record.state, record.why) == ("failed", "action 'b' failed: told")


def test_a_choice_does_one_of_its_steps() -> None:
    one = Choice(steps=(act("a"), act("b")))
    assert Played(task("t", one), chosen=1).names() == ["b"]


def test_repetitions_end_by_times_or_a_condition_or_never() -> None:
    played = Played(task("t", Repeat(steps=(act("a"),), times=2), act("b")))
    assert played.end("a") == ["a"]
    assert played.end("a") == ["b"]
    until = Repeat(steps=(act("a"),), until=Until(when="late == 0"))
    played = Played(task("t", until, act("b")))
    assert played.after(1.0) == ["a"]
    assert played.after(1.0, "late == 0") == ["b"]
    played = Played(task("t", Repeat(steps=(act("a"),))))
    for _ in range(50):
        assert played.end("a") == ["a"]


def test_the_steps_of_another_task_are_named_with_it() -> None:
    played = Played(task("t", Subtask(task="greet")), task("greet", act("wave")))
    assert "greet.wave" in played.names()


def test_a_limit_counts_only_while_the_action_works() -> None:
    played = Played(task("t", act("a", limit=10.0), act("b")))
    played.after(6.0)
    played.tasks.pause("t", played.now)
    assert played.after(100.0) == []
    assert played.states() == {"t": "paused"}
    played.tasks.resume("t", played.now)
    played.work()
    assert played.after(3.9) == ["a"]
    assert played.after(0.2) == []
    assert "its limit of 10 s is over" in played.tasks.records[0].why


def test_a_limit_does_not_count_while_another_task_uses_the_device() -> None:
    low = task("low", act("grasp it", "grasp", limit=10.0))
    high = task("high", act("push it", "push"), priority=5)
    played = Played(low)
    played.after(6.0)
    played.tasks = Tasks(
        robot_with(low, high), played.said.append, saved=played.tasks.saved
    )
    played.tasks.start("high", played.now)
    played.work()
    assert played.after(100.0) == ["push it"]
    assert played.end("push it") == ["grasp it"]
    assert "action 'grasp it' of task 'low' goes on" in played.said
    assert played.after(3.9) == ["grasp it"]
    assert played.after(0.2) == []


def test_a_condition_ends_an_action_as_done() -> None:
    played = Played(task("t", act("a", until=Until(when="late == 0")), act("b")))
    assert played.after(1.0) == ["a"]
    assert played.after(1.0, "late == 0") == ["b"]


def test_a_condition_that_ends_an_action_and_the_repetition_around_it_ends_both() -> (
    None
):
    until = Until(when="late == 0")
    played = Played(task("t", Repeat(steps=(act("a", until=until),), until=until)))
    assert played.after(1.0, "late == 0") == []
    told = "action 'a' of task 't' is done: late == 0 holds"
    assert [text for text in played.said if "late == 0" in text] == [
        told,
        "task 't': a repetition ends: late == 0 holds",
    ]
    assert [(each.action.name, each.done) for each in played.tasks.pop_ended()] == [
        ("a", True)
    ]


def test_on_failure_it_begins_again_then_does_something_else() -> None:
    instead = Retry(times=2, then=act("c"))
    played = Played(task("t", act("a", on_failure=instead), act("b")))
    numbers = []
    for _ in range(2):
        numbers += [t.number for t in played.tasks.tries(played.tasks.records[0])]
        assert played.end("a", done=False) == ["a"]
    assert played.end("a", done=False) == ["c"]
    assert len(set(numbers)) == 2
    assert played.end("c") == ["b"]


def test_what_is_done_instead_may_fail_too() -> None:
    played = Played(task("t", act("a", on_failure=act("c")), act("b")))
    assert played.end("a", done=False) == ["c"]
    assert played.end("c", done=False) == []
    assert played.states() == {"t": "failed"}
    assert played.tasks.records[0].why.startswith("action 'c' failed: ")


def test_an_end_of_an_earlier_try_ends_nothing() -> None:
    played = Played(task("t", act("a", on_failure=Retry(times=1))))
    (first,) = played.tasks.tries(played.tasks.records[0])
    number = first.number
    played.end("a", done=False)
    played.tasks.end(number, 0.0, "late", done=False)
    assert played.names() == ["a"]


def test_the_higher_priority_gets_the_device_and_the_lower_goes_on_after_it() -> None:
    low = task("low", act("grasp it", "grasp", limit=100.0))
    high = task("high", act("push it", "push"), priority=5)
    played = Played(low)
    played.robot = robot_with(low, high)
    played.tasks = Tasks(played.robot, played.said.append, saved=played.tasks.saved)
    played.tasks.start("high", 1.0)
    played.work()
    assert played.names() == ["push it"]
    assert played.states() == {"low": "waiting", "high": "going"}
    assert played.tasks.find("low").why == "task 'high' uses the device 'arm'"
    assert played.end("push it") == ["grasp it"]
    assert played.states() == {"low": "going", "high": "done"}


def test_of_equal_priority_the_one_at_work_keeps_what_it_has() -> None:
    first = task("first", act("a"), act("say", "talk"))
    second = task("second", act("speak", "talk"))
    played = Played(first, second)
    assert played.names() == ["a", "speak"]
    assert played.end("a") == ["speak"]
    assert played.tasks.find("first").why == "task 'second' uses the function 'talk'"
    assert played.end("speak") == ["say"]


def test_a_task_that_is_cancelled_frees_what_it_used() -> None:
    played = Played(task("one", act("x", "grasp")), task("two", act("y", "push")))
    assert played.names() == ["x"]
    played.tasks.cancel("one", 1.0)
    played.work()
    assert played.names() == ["y"]
    assert played.states() == {"one": "cancelled", "two": "going"}
    (ended,) = played.tasks.tries(played.tasks.records[0])
    assert ended.progress.since is None  # its status says that it works no more


def test_a_task_that_was_blocked_says_for_what_it_waits() -> None:
    played = Played(task("t", act("a")))
    played.tasks.block("t", "there is no room for it")
    played.work()
    assert played.names() == []
    assert played.tasks.find("t").why == "there is no room for it"
    played.tasks.unblock()
    played.work()
    assert played.names() == ["a"]


@pytest.mark.parametrize("do", ["pause", "resume", "cancel"])
def test_what_does_not_run_cannot_be_commanded(do: str) -> None:
    tasks = Tasks(robot_with(task("t", act("a"))))
    with pytest.raises(UsageError, match="task 't' does not run"):
        getattr(tasks, do)("t", 0.0)
    with pytest.raises(UsageError, match="no task 'x'"):
        getattr(tasks, do)("x", 0.0)


def test_a_task_runs_once_at_a_time_and_may_run_again() -> None:
    played = Played(task("t", act("a")))
    with pytest.raises(UsageError, match="task 't' runs already"):
        played.tasks.start("t", 0.0)
    played.end("a")
    played.tasks.start("t", 1.0)
    assert list(played.states().items()) == [("t", "going")]
    assert [r.state for r in played.tasks.records] == ["done", "going"]


def test_of_the_tasks_that_are_over_only_the_last_are_kept() -> None:
    played = Played(task("t", act("a")))
    started = [played.tasks.records[0]]
    for _ in range(MOST_OVER + 5):
        played.end("a")
        started.append(played.tasks.start("t", played.now))
        played.work()
    assert played.tasks.records == started[-MOST_OVER:]


def test_says_since_when_a_task_is_as_it_is() -> None:
    played = Played(task("t", act("a")))
    (record,) = played.tasks.records
    began = record.since
    played.now = 5.0
    played.tasks.pause("t", played.now)
    assert record.since == pytest.approx(began + 5.0, abs=1.0)
    played.now = 9.0
    played.tasks.pause("t", played.now)
    assert record.since == pytest.approx(began + 5.0, abs=1.0)
    played.tasks.cancel("t", played.now)
    assert record.since == pytest.approx(began + 9.0, abs=1.0)
    assert played.said[-2:] == [
        "task 't' is paused: on request",
        "task 't' is cancelled: on request",
    ]


def test_the_next_manager_goes_on_where_this_one_was() -> None:
    steps = act("a", on_failure=Retry(times=3)), act("b", limit=5.0)
    played = Played(task("t", *steps))
    played.end("a", done=False)
    played.end("a")
    played.after(3.0)
    text = msgspec.json.encode(played.tasks.saved)
    saved = msgspec.json.decode(text, type=Saved)
    again = Tasks(played.robot, played.said.append, saved=saved)
    (each,) = again.tries(again.find("t"))
    assert (each.name, again.worked(each, 3.0)) == ("b", 3.0)


def test_a_task_that_the_robot_file_has_no_more_is_given_up_and_said() -> None:
    played = Played(task("t", act("a")))
    said: list[str] = []
    Tasks(robot_with(), said.append, saved=played.tasks.saved)
    assert said == ["task 't' is dropped: the robot file no longer has it"]


def test_what_comes_next_is_known_with_its_probability() -> None:
    both = Parallel(steps=(act("a"), act("b", "drive")))
    played = Played(task("t", both, act("c", "talk")))
    assert [(t.name, p) for t, p in played.tasks.next_actions()] == [("c", 1.0)]
    ways = Parallel(
        steps=(
            Sequence(steps=(act("a"), act("x", "talk"))),
            Sequence(steps=(act("b"), act("y", "drive"))),
        )
    )
    played = Played(task("t", ways))
    found = [(t.name, p) for t, p in played.tasks.next_actions()]
    assert found == [("x", 0.5), ("y", 0.5)]
    played = Played(task("t", act("a"), Choice(steps=(act("x"), act("y")))), chosen=1)
    assert [t.name for t, _ in played.tasks.next_actions()] == ["y"]


def test_next_of_a_task_that_waits_is_what_it_waits_with() -> None:
    played = Played(task("one", act("x", "grasp")), task("two", act("y", "push")))
    assert [(t.task, t.name) for t, _ in played.tasks.next_actions()] == [("two", "y")]


@st.composite
def steps(draw: st.DrawFn, depth: int = 2) -> Step:
    kinds = ["action"] if depth == 0 else ["action", "in turn", "choice", "repeat"]
    kind = draw(st.sampled_from(kinds))
    if kind == "action":
        failure = draw(st.sampled_from(["give up", Retry(times=1)]))
        limit = draw(st.sampled_from([None, 5.0]))
        functions = draw(st.lists(st.sampled_from(FUNCTIONS), max_size=2, unique=True))
        name = f"a{draw(st.integers(0, 10**6))}"
        return act(name, *functions, limit=limit, on_failure=failure)
    several = draw(st.lists(steps(depth - 1), min_size=2, max_size=3))
    if kind == "in turn":
        return Sequence(steps=tuple(several))
    if kind == "choice":
        return Choice(steps=tuple(several))
    return Repeat(steps=tuple(several), times=draw(st.sampled_from([1, 2, None])))


MOVES = st.tuples(
    st.sampled_from(["done", "failed", "time", "pause", "resume", "cancel", "start"]),
    st.integers(0, 2),
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    programs=st.lists(
        st.lists(steps(), min_size=1, max_size=3), min_size=2, max_size=3
    ),
    priorities=st.lists(st.integers(0, 2), min_size=3, max_size=3),
    moves=st.lists(MOVES, max_size=40),
)
def test_never_two_holders_and_every_task_ends_or_waits_for_something_named(
    programs: list[list[Step]],
    priorities: list[int],
    moves: list[tuple[str, int]],
) -> None:
    played = Played(
        *(
            task(f"t{i}", *program, priority=priorities[i])
            for i, program in enumerate(programs)
        )
    )
    for what, which in moves:
        move(played, what, which, programs=len(programs))
        assert_nothing_is_held_twice(played)
        for record in played.tasks.records:
            assert_it_runs_or_waits(played, record)
    if any(r.state == "waiting" for r in played.tasks.records):
        assert played.tasks.going()


def move(played: Played, what: str, which: int, *, programs: int) -> None:
    name = f"t{which}"
    running = [t for r in played.tasks.going() for t in played.tasks.tries(r)]
    if what in {"done", "failed"} and running:
        each = running[which % len(running)]
        played.tasks.end(each.number, played.now, "told", done=what == "done")
    elif what == "time":
        played.after(3.0)
    elif what == "start" and which < programs:
        with contextlib.suppress(UsageError):
            played.tasks.start(name, played.now)
    elif what in {"pause", "resume", "cancel"}:
        with contextlib.suppress(UsageError):
            getattr(played.tasks, what)(name, played.now)
    played.work()


def assert_nothing_is_held_twice(played: Played) -> None:
    granted = [
        msgspec.structs.replace(t.action, name=f"{r.name}.{t.name}")
        for r in played.tasks.going()
        for t in played.tasks.tries(r)
    ]
    for clash in clashes(played.robot, granted):
        users = {
            action.name.split(".")[0]
            for action in granted
            if any(f"'{action.name}'" in user for user in clash.users)
        }
        assert len(users) < 2, clash


def assert_it_runs_or_waits(played: Played, record: TaskRecord) -> None:
    tries = played.tasks.tries(record)
    if record.state in OVER:
        return
    assert tries
    is_at_work = [t.progress.since is not None for t in tries]
    if record.state == "going":
        assert all(is_at_work)
    else:
        assert record.why
        assert not any(is_at_work)
