"""How long phases last and how often they are reached, where a file says little."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from poise.model import load
from poise.model.phases import LEAST_SHARE, assumed, phases_of
from poise.model.robot import Robot

HEAD = """
robot: r
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  drive: {function: drive, components: {wheels: {}}}
  see: {function: see, components: {eyes: {}}}
  look: {function: see, quality: 0.5, components: {lens: {}}}
tasks:
  t:
    actions:
"""


def robot(tmp_path: Path, *steps: str) -> Robot:
    path = tmp_path / "robot.yaml"
    path.write_text(HEAD + "".join(f"      - {step}\n" for step in steps))
    return load(path)


def seconds(robot: Robot) -> dict[str, float]:
    """Return how long the task is in each phase."""
    return {phase.name: phase.lasts for phase in phases_of(robot, "t")}


def action(name: str, limit: str = "", more: str = "", function: str = "see") -> str:
    limit = f", limit: {limit}" if limit else ""
    return f"{{name: {name}, functions: [{function}]{limit}{more}}}"


def test_an_action_takes_its_limit_and_half_a_minute_without_one(
    tmp_path: Path,
) -> None:
    known = robot(tmp_path, action("a", "1 h"), action("b", "1 s"), action("c"))
    assert seconds(known) == {"a": 3600, "b": 1, "c": 30}
    assert [*assumed(known, "t")] == ["c takes 30 s, as it has no limit"]


def test_phases_of_which_nothing_is_known_last_equally_long(tmp_path: Path) -> None:
    unknown = robot(tmp_path, *(action(name) for name in "abc"))
    assert seconds(unknown) == {"a": 30, "b": 30, "c": 30}
    (said,) = assumed(unknown, "t")
    assert said == "every action takes 30 s, as it has no limit"


def test_what_is_done_on_failure_is_reached_every_other_time(tmp_path: Path) -> None:
    """With two retries: 1 + 1/2 + 1/4 tries of 8 s, and in 1/8 all have failed."""
    instead = ", on failure: " + action("b", "40 s")
    once = robot(tmp_path, action("a", "8 s", instead), action("c", "10 s"))
    assert seconds(once) == {"a": 8, "b": 20, "c": 10}
    then = action("b", "40 s")
    thrice = ", on failure: {retry: 2, then: " + then + "}"
    again = robot(tmp_path, action("a", "8 s", thrice), action("c", "10 s"))
    assert seconds(again) == {"a": 14, "b": 5, "c": 10}
    after = {phase.name: phase.after for phase in phases_of(again, "t")}
    assert after == {"a": {}, "b": {"a": 1 / 8}, "c": {"a": 7 / 8, "b": 1 / 8}}
    (said,) = assumed(again, "t")
    assert said == "a succeeds every other time, as nothing is learned"


def test_what_was_learned_of_an_action_is_expected_of_it(tmp_path: Path) -> None:
    """`a` succeeds in 90 %, so `b` is reached in 10 %; without one, a task ends."""
    instead = ", on failure: " + action("b", "40 s", function="drive")
    known = robot(tmp_path, action("a", "8 s", instead), action("c", "10 s"))
    learned = replace(known, success={"a": 0.9})
    found = seconds(learned)
    assert found == pytest.approx({"a": 8, "b": 4, "c": 10})
    assert not [*assumed(learned, "t")]
    plain = robot(tmp_path, action("a", "8 s"), action("c", "10 s"))
    ends = replace(learned, tasks=plain.tasks)
    assert seconds(ends) == pytest.approx({"a": 8, "c": 9})


def test_steps_of_a_choice_come_as_often_as_they_promise(tmp_path: Path) -> None:
    """Both architectures of `see` succeed in half; `drive` in all: 1/3 and 2/3."""
    choice = f"choice: [{action('a', '9 s')}, {action('b', '9 s', '', 'drive')}]"
    known = robot(tmp_path, choice, action("c", "1 s", function="drive"))
    assert seconds(known) == {"a": 4.5, "b": 4.5, "c": 1}
    half = tuple(
        replace(a, success=0.5) if a.function == "see" else a
        for a in known.architectures
    )
    success = {"a": 0.5}
    found = seconds(replace(known, architectures=half, success=success))
    # a is done in half of the cases, b always: c in 1/3 * 1/2 + 2/3
    assert found == pytest.approx({"a": 3, "b": 6, "c": 5 / 6})
    assert "in proportion to what they promise" in next(assumed(known, "t"))


@pytest.mark.parametrize(("times", "rounds"), [(", times: 3", 3), ("", 10)])
def test_what_is_repeated_lasts_longer(tmp_path: Path, times: str, rounds: int) -> None:
    again = f"{{repeat: [{action('a', '2 s')}, {action('b', '1 s')}]{times}}}"
    known = robot(tmp_path, again, action("c", "5 s"))
    assert seconds(known) == {"a": 2 * rounds, "b": rounds, "c": 5}
    after = {phase.name: phase.after for phase in phases_of(known, "t")}
    assert after == {"a": {"b": rounds - 1}, "b": {"a": rounds}, "c": {"b": 1}}
    assert len([*assumed(known, "t")]) == (0 if times else 1)


def test_steps_at_once_last_as_long_as_the_longest(tmp_path: Path) -> None:
    """`a` takes a quarter of the way of one, `b` the rest; `c` lasts 2 s of the 8."""
    way = f"{{sequence: [{action('a', '2 s')}, {action('b', '6 s')}]}}"
    both = f"parallel: [{way}, {action('c', '2 s')}]"
    assert seconds(robot(tmp_path, both)) == {"a+c": 2, "b+c": 6}


def test_no_phase_counts_for_nothing(tmp_path: Path) -> None:
    """After 100 retries `b` is not reached; of 2000 s it has a ten-thousandth."""
    instead = ", on failure: {retry: 100, then: " + action("b", "1 s") + "}"
    found = seconds(robot(tmp_path, action("a", "1000 s", instead)))
    assert found == pytest.approx({"a": 2000, "b": 2000 * LEAST_SHARE})
    huge = f"{{repeat: [{action('a', '1 s')}], times: {10**9}}}"
    assert seconds(robot(tmp_path, huge)) == {"a": 10**6}
