"""Which actions of a task run at the same time, and what may follow what."""

from pathlib import Path

import pytest

from poise.errors import RobotError
from poise.model import load
from poise.model.phases import MOST_PHASES, TooManyPhasesError, phases_of
from poise.model.robot import Computer, Robot, Task
from poise.model.steps import Action, Parallel, Sequence, Subtask

HEAD = """
robot: r
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  drive: {function: drive, components: {wheels: {}}}
  see: {function: see, components: {eyes: {}}}
tasks:
  wave: {actions: [{name: up, functions: [see]}, {name: down, functions: []}]}
  t:
    actions:
"""


def flow(tmp_path: Path, *steps: str) -> dict[str, tuple[str, ...]]:
    """Return the phases of a task with these steps, each with those before it."""
    path = tmp_path / "robot.yaml"
    path.write_text(HEAD + "".join(f"      - {step}\n" for step in steps))
    return {phase.name: (*phase.after,) for phase in phases_of(load(path), "t")}


A, B, C, D = (f"{{name: {n}, functions: [drive]}}" for n in "abcd")


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([A], {"a": ()}),
        ([A, B, C], {"a": (), "b": ("a",), "c": ("b",)}),
        ([A, f"parallel: [{B}, {C}]"], {"a": (), "b+c": ("a",)}),
        (
            [A, f"choice: [{B}, {C}]", D],
            {"a": (), "b": ("a",), "c": ("a",), "d": ("b", "c")},
        ),
        ([f"{{repeat: [{A}, {B}], times: 3}}"], {"a": ("b",), "b": ("a",)}),
        ([f"{{repeat: [{A}, {B}], times: 1}}"], {"a": (), "b": ("a",)}),
        (
            [f"parallel: [{{sequence: [{A}, {B}]}}, {{sequence: [{C}, {D}]}}]"],
            {
                "a+c": (),
                "a+d": ("a+c",),
                "b+c": ("a+c",),
                "b+d": ("a+d", "b+c"),
            },
        ),
        (
            [f"{{name: x, functions: [], on failure: {A}}}", B],
            {"x": (), "a": ("x",), "b": ("x", "a")},
        ),
        (
            [f"{{name: x, functions: [], on failure: {{retry: 2, then: {A}}}}}"],
            {"x": (), "a": ("x",)},
        ),
        (
            [A, "task: wave"],
            {"a": (), "wave.up": ("a",), "wave.down": ("wave.up",)},
        ),
        # The same actions at another time are the same phase.
        (
            ["task: wave", A, "task: wave"],
            {"wave.up": ("a",), "wave.down": ("wave.up",), "a": ("wave.down",)},
        ),
    ],
)
def test_phases(
    tmp_path: Path, steps: list[str], expected: dict[str, tuple[str, ...]]
) -> None:
    found = flow(tmp_path, *steps)
    assert {name: {*after} for name, after in found.items()} == {
        name: {*after} for name, after in expected.items()
    }


def test_functions_of_a_task_are_those_of_all_its_steps(tmp_path: Path) -> None:
    failing = f"{{name: x, functions: [], on failure: {A}}}"
    flow(tmp_path, failing, "task: wave")
    robot = load(tmp_path / "robot.yaml")
    assert robot.functions_of("t") == ("drive", "see")
    assert robot.functions_of("nothing") == ()


def by_hand(*tasks: Task) -> Robot:
    return Robot(name="r", computers=(Computer(name="main"),), tasks=tasks)


def test_refuses_a_task_within_itself_and_too_many_phases() -> None:
    endless = by_hand(Task(name="t", actions=(Subtask(task="t"),)))
    with pytest.raises(RobotError, match="t -> t"):
        phases_of(endless, "t")
    steps = [
        Sequence(steps=tuple(Action(name=f"{x}{i}", functions=()) for i in range(11)))
        for x in "ab"
    ]
    with pytest.raises(TooManyPhasesError, match=str(MOST_PHASES)):
        phases_of(by_hand(Task(name="t", actions=(Parallel(steps=tuple(steps)),))), "t")
