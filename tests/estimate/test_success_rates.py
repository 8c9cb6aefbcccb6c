"""What was learned weighs among alternatives, and breaks nothing."""

import contextlib
import sqlite3
from pathlib import Path
from random import Random

import pytest
from msgspec.structs import replace

import poise
from poise.errors import UsageError
from poise.estimate.outcomes import KEPT, STORE, forget, note_outcome
from poise.estimate.success_rates import (
    DISCOUNT,
    SuccessRate,
    beliefs_about,
    change_point,
    learned,
    rates,
    with_success,
)
from poise.manage.journal import Journal
from poise.model.loading import load
from poise.model.robot import Robot, Task
from poise.model.steps import Retry
from poise.session.placing.first_phase import note_architectures
from poise.session.placing.placement import place

TEXT = """
robot: picker
computers:
  left: {cpu: 1, memory: 1 GiB}
  right: {cpu: 1, memory: 1 GiB}
architectures:
  guard:
    {function: safety, layer: reactive, home: left, components: {dog: {cpu: 30%}}}
  gripper:
    function: grasping
    components: {fingers: {cpu: 20%, only: [right]}}
  suction:
    function: grasping
    components: {cup: {cpu: 20%, only: [right]}}
tasks:
  tidy: {actions: [{name: pick, functions: [grasping, safety]}]}
  pack: {actions: [{name: lift, functions: [grasping]}]}
"""


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    path = tmp_path / "robot.yaml"
    path.write_text(TEXT)
    return load(path)


def success(robot: Robot, task: str | None = None, **options: object) -> list[float]:
    """Return what was learned of gripper and suction."""
    known = learned(robot, robot.actions(task), **options).robot  # type: ignore[arg-type]
    return [a.success for a in known.architectures if a.function == "grasping"]


def test_nothing_learned_changes_nothing(robot: Robot) -> None:
    """And no file is made."""
    assert learned(robot, robot.actions("tidy")).robot == robot
    assert place(robot, "tidy").architectures["grasping"] == "gripper"
    assert not (Path(robot.folder) / ".poise").exists()


def test_phases_last_as_was_learned_of_actions_without_alternatives(
    robot: Robot,
) -> None:
    """Two of three failed: 2/5. An outcome of two functions counts once."""
    ways = [replace(a, on_failure=Retry(times=1)) for a in robot.actions("tidy")]
    again = replace(robot, tasks=(Task(name="tidy", actions=tuple(ways)),))
    (said,) = place(again, "tidy").task_result.problem.assumed[1:]
    assert said == "pick succeeds every other time, as nothing is learned"
    for ending in ("done", "failed", "failed"):
        note_outcome(again, "pick", ending, ["guard", "gripper"])
    known = place(again, "tidy").task_result.problem
    assert known.assumed[1:] == ()
    (phase,) = known.phases
    assert phase.lasts == pytest.approx(30 * (1 + 3 / 5), rel=0.01)
    assert with_success(robot, robot.actions("pack")).success == {}


def test_an_outcome_changes_the_choice(robot: Robot) -> None:
    """1 of 1 failed: 1/3, and of the other nothing is known: 1/2."""
    note_outcome(robot, "pick", "failed", place(robot, "tidy").architectures)
    assert success(robot, "tidy") == [pytest.approx(1 / 3), 0.5]
    assert place(robot, "tidy").architectures["grasping"] == "suction"
    assert poise.place(robot, "pack").architectures["grasping"] == "gripper"


def test_a_task_counts_the_actions_that_need_the_function(robot: Robot) -> None:
    """Of all tasks: (1/3 + 1/2) / 2."""
    note_outcome(robot, "pick", "failed", ["gripper"])
    assert success(robot, None) == [pytest.approx(5 / 12), 0.5]


def test_learns_each_situation_apart(robot: Robot) -> None:
    """What failed when the CPU was short says nothing of other times."""
    short = poise.Conditions(cpu_is_short=True)
    note_outcome(robot, "pick", "failed", ["gripper"], conditions=short)
    assert success(robot, "tidy") == [1.0, 1.0]
    assert success(robot, "tidy", conditions=short) == [pytest.approx(1 / 3), 0.5]


def test_a_changed_architecture_is_learned_anew(robot: Robot) -> None:
    """Its old outcomes are shown, and do not count."""
    note_outcome(robot, "pick", "failed", ["gripper"])
    changed = robot.with_components(lambda c: replace(c, parameters={"force": 2}))
    assert success(changed, "tidy") == [1.0, 1.0]
    (belief,) = beliefs_about(changed, "gripper")
    assert (belief.failed, belief.is_present) == (1, False)


def test_forgets_when_asked(robot: Robot) -> None:
    """Only the one architecture."""
    note_outcome(robot, "pick", "failed", ["gripper", "suction"])
    assert forget(robot, "gripper") == 1
    assert beliefs_about(robot, "gripper") == []
    assert len(beliefs_about(robot, "suction")) == 1


def test_explores_only_when_told(robot: Robot) -> None:
    """By option or robot file; the same seed draws the same, and others differ."""
    assert success(robot, "tidy") == [1.0, 1.0]
    drawn = success(robot, "tidy", explore=True)
    assert drawn != [1.0, 1.0]
    assert success(replace(robot, explore=True), "tidy") == drawn
    chosen = {
        place(robot, "tidy", explore=True, seed=seed).architectures["grasping"]
        for seed in range(20)
    }
    assert chosen == {"gripper", "suction"}


@pytest.mark.parametrize("rates", [(1e-9, 1, 1e-9), (1, 1e-9, 1), (1e-9,) * 3])
def test_never_breaks_a_pin_or_a_layer(
    robot: Robot, rates: tuple[float, float, float]
) -> None:
    """Whatever was learned: what does not fit loses, and fixed layers stay."""
    robot = replace(
        robot,
        architectures=tuple(
            replace(a, success=rate)
            for a, rate in zip(robot.architectures, rates, strict=True)
        ),
    )
    placed = place(robot, "tidy")
    assert placed.feasible
    assert placed["dog"] == "left"
    assert {placed[c] for c in placed.where if c != "dog"} == {"right"}
    full = robot.with_components(
        lambda c: replace(c, demand={"cpu": 2.0}) if c.name == "cup" else c
    )
    assert place(full, "tidy").architectures["grasping"] == "gripper"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("picc", "done", ["gripper"]), "no action 'picc' .did you mean 'pick'"),
        (("pick", "ended", ["gripper"]), "ending is 'ended'"),
        (("pick", "done", ["griper"]), "no architecture 'griper' .did you mean"),
    ],
)
def test_refuses_unknown_names(
    robot: Robot, arguments: tuple[str, str, list[str]], words: str
) -> None:
    """Nothing is kept of them."""
    with pytest.raises(UsageError, match=words):
        note_outcome(robot, *arguments)  # type: ignore[arg-type]
    assert success(robot) == [1.0, 1.0]


def test_the_journal_names_what_ran_by_its_hash(robot: Robot) -> None:
    """And what else there was, so that a later choice can be told, too."""
    journal = Journal(":memory:")
    note_architectures(journal, robot, place(robot, "tidy"))
    (entry,) = journal.entries()
    facts = entry.facts["architectures"]
    assert [name for name in facts if facts[name]["runs"]] == ["guard", "gripper"]
    assert f"grasping by 'gripper' ({facts['gripper']['hash']})" in entry.what
    journal.close()


def test_knows_nothing_before_the_first_outcome() -> None:
    """Uniform over [0, 1]: mean 1/2, deviation sqrt(1/12)."""
    assert SuccessRate().mean == 0.5
    assert SuccessRate().deviation == pytest.approx((1 / 12) ** 0.5)


def test_learns_from_outcomes() -> None:
    """Beta(3, 2) after 2 of 3: mean 3/5, variance 1/25."""
    rate = SuccessRate(done=2, failed=1)
    assert rate.mean == pytest.approx(3 / 5)
    assert rate.deviation == pytest.approx(1 / 5)


def test_draws_as_it_believes() -> None:
    """The mean of 10,000 draws is within 5 standard errors, and a seed repeats it."""
    rate = SuccessRate(done=8, failed=1)
    random = Random(1)
    draws = [rate.sample(random) for _ in range(10_000)]
    error = rate.deviation / 100
    assert sum(draws) / 10_000 == pytest.approx(rate.mean, abs=5 * error)
    assert draws[0] == rate.sample(Random(1))


def test_an_outcome_counts_for_less_with_each_later_one() -> None:
    """Whichever alternative that one is of."""
    a, b = ("a", "1"), ("b", "2")
    of = rates([(a, True), (b, True), (a, False)])
    assert of[a] == pytest.approx((DISCOUNT**2, 1.0))
    assert of[b] == pytest.approx((DISCOUNT, 0.0))


def test_finds_where_the_rate_changed() -> None:
    """After 20 that were done, 5 failures are evidence enough and 1 is not.

    Of 25: 20 kl(1, 4/5) + 5 kl(0, 4/5) = 20 ln(5/4) + 5 ln 5 = 12.5, above
    ln(25^1.5 / 0.05) = 7.8; of 21: 20 ln(21/20) + ln 21 = 4.0, below 7.6.
    """
    assert change_point([True] * 20 + [False] * 5) == 20
    assert change_point([True] * 20 + [False]) == 0
    assert change_point([]) == change_point([True]) == 0


def test_a_change_ends_what_was_known_of_all_alternatives() -> None:
    """What was learned of the other before may be wrong now, too."""
    a, b = ("a", "1"), ("b", "2")
    of = rates([(b, False)] * 4 + [(a, True)] * 20 + [(a, False)] * 5)
    assert b not in of
    assert of[a].done == 0


@pytest.mark.parametrize("before", [50, 200])
@pytest.mark.parametrize("explore", [False, True])
def test_notices_that_two_alternatives_have_swapped(
    before: int, *, explore: bool
) -> None:
    """90 % and 30 % until then, and the other way round for 100 outcomes after.

    Counts that never forgot chose the worse one 50 to 100 times.
    """
    wrong = [wrong_choices(before, seed, explore=explore) for seed in range(4)]
    assert sum(wrong) / 4 < 35


def wrong_choices(before: int, seed: int, *, explore: bool) -> int:
    """Return how often the worse one is chosen, until 100 times after the swap."""
    world, wrong = Random(seed), 0
    outcomes: list[tuple[tuple[str, str], bool]] = []
    for count in range(before + 100):
        known = rates(outcomes[-KEPT:])
        of = [known.get((name, ""), SuccessRate()) for name in "ab"]
        a, b = (r.sample(world) if explore else r.mean for r in of)
        best = "a" if count < before else "b"
        chosen = "a" if a >= b else "b"
        wrong += chosen != best
        done = world.random() < (0.9 if chosen == best else 0.3)
        outcomes.append(((chosen, ""), done))
    return wrong


def test_keeps_the_last_outcomes_of_an_action(robot: Robot) -> None:
    """501 of one action, of which 400 are kept when one more ends; 1 of the other."""
    note_outcome(robot, "lift", "failed", ["gripper"])
    with contextlib.closing(sqlite3.connect(Path(robot.folder) / STORE)) as base, base:
        base.execute(
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION SELECT i + 1 FROM n WHERE i < 500) "
            "INSERT INTO outcomes SELECT NULL, robot, at, action, situation, function, "
            "architecture, hash, ending FROM outcomes, n"
        )
    note_outcome(robot, "pick", "done", ["gripper"])
    note_outcome(robot, "lift", "done", ["gripper"])
    assert forget(robot, "gripper") == KEPT + 1


def test_refuses_what_is_no_store(robot: Robot) -> None:
    """The file is named, and what to do about it."""
    file = Path(robot.folder) / STORE
    file.parent.mkdir()
    file.write_text("no database, but long enough to look at" * 10)
    with pytest.raises(UsageError, match=r"success\.sqlite cannot store .* remove it"):
        success(robot)


def test_the_order_of_lost_computers_means_nothing() -> None:
    """They are a set."""
    assert poise.Conditions(lost=("b", "a", "b")) == poise.Conditions(lost=("a", "b"))
    assert str(poise.Conditions(lost=("b", "a"))) == "without a, b"
