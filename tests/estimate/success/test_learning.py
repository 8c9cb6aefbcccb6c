"""What was learned weighs among alternatives, and breaks nothing."""

from pathlib import Path

import pytest
from msgspec.structs import replace

import poise
from poise.errors import UsageError
from poise.estimate.success.learning import (
    actions_in,
    beliefs_about,
    forget,
    learned,
    note_outcome,
)
from poise.manage.journal import Journal
from poise.model.load import load
from poise.model.robot import Robot
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
    known = learned(robot, actions_in(robot, task), **options).robot  # type: ignore[arg-type]
    return [a.success for a in known.architectures if a.function == "grasping"]


def test_nothing_learned_changes_nothing(robot: Robot) -> None:
    """And no file is made."""
    assert learned(robot, actions_in(robot, "tidy")).robot == robot
    assert place(robot, "tidy").architectures["grasping"] == "gripper"
    assert not (Path(robot.folder) / ".poise").exists()


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
