"""Arguments of a robot file, and one file that is included twice."""

from pathlib import Path

import pytest

from poise.errors import FileProblem, RobotError, UsageError
from poise.model import load

TOP = """robot: r
computers: {main: {cpu: 1, memory: 1 GiB}, vision: {cpu: 1, memory: 1 GiB}}
"""
ARM = """
arguments: {side: none, cpu: 5%}
devices:
  servo: {computer: main, path: /dev/$(side)}
architectures:
  arm:
    function: reach
    components:
      hand: {cpu: $(cpu), devices: [servo]}
      eye: {cpu: 1%, ros2: {executable: ./eye.py, namespace: /$(side)}}
    connectors:
      - {between: [eye, hand], topic: /$(side)/seen, message: 10 B, rate: 10 Hz}
connectors:
  - {between: [hand, pilot], message: 10 B, rate: 10 Hz}
chains:
  look: {through: [eye, hand], deadline: 1 s}
apart: [[eye, hand]]
"""


def write(folder: Path, robot: str, arm: str = ARM) -> Path:
    (folder / "arm.yaml").write_text(arm)
    (folder / "robot.yaml").write_text(robot)
    return folder / "robot.yaml"


def problems(path: Path) -> tuple[FileProblem, ...]:
    with pytest.raises(RobotError) as error:
        load(path)
    return error.value.problems


def component(text: str) -> str:
    return f"{TOP}architectures:\n  a: {{function: f, components: {{pilot: {text}}}}}\n"


def test_an_argument_has_its_default_or_what_is_given(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        component("{parameters: {gain: $(gain), path: /dev/$(side)}}")
        + "arguments: {gain: 0.5, side: left}\n",
    )
    assert load(path).component("pilot").parameters == {
        "gain": 0.5,
        "path": "/dev/left",
    }
    robot = load(path, {"gain": 2, "side": "right"})
    assert robot.component("pilot").parameters == {"gain": 2, "path": "/dev/right"}
    assert robot.arguments == {"gain": "2", "side": "right"}


def test_an_argument_may_use_those_before_it(tmp_path: Path) -> None:
    text = component("{parameters: {path: $(path)}}")
    text += "arguments: {side: left, path: /dev/$(side)}\n"
    robot = load(write(tmp_path, text), {"side": "right"})
    assert robot.component("pilot").parameters == {"path": "/dev/right"}


def test_a_value_has_the_type_of_its_key_and_an_error_names_the_key(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, component("{cpu: $(need)}") + "arguments: {need: 5%}\n")
    assert load(path).component("pilot").demand == {"cpu": 0.05}
    with pytest.raises(RobotError, match=r"robot.yaml:4:.*pilot.cpu: 'much'"):
        load(path, {"need": "much"})


def test_an_unknown_argument_is_told_with_the_likely_one(tmp_path: Path) -> None:
    path = write(tmp_path, component("{}") + "arguments: {gain: 0.5}\n")
    with pytest.raises(UsageError, match=r"no argument 'gian' \(did you mean 'gain'"):
        load(path, {"gian": 1})


def test_a_reference_to_no_argument_is_told_where_it_is(tmp_path: Path) -> None:
    text = component("{parameters: {gain: $(gian)}}") + "arguments: {gain: 0.5}\n"
    (problem,) = problems(write(tmp_path, text))
    assert (problem.line, problem.column) == (4, 54)
    assert "no argument 'gian' (did you mean 'gain'?)" in problem.message


def test_a_problem_elsewhere_leaves_arguments_their_values(tmp_path: Path) -> None:
    text = component("{cpu: $(cpu)}") + "arguments: {cpu: 5%}\nrobot: again\n"
    (problem,) = problems(write(tmp_path, text))
    assert "'robot' is defined twice" in problem.message


def test_what_an_alias_repeats_is_filled_once(tmp_path: Path) -> None:
    text = f"{TOP}architectures:\n  a: {{function: f, components: {{x: "
    text += '{parameters: &p {say: "$$(gain)"}}, y: {parameters: *p}}}\n'
    robot = load(write(tmp_path, text))
    assert [c.parameters for c in robot.components()] == [{"say": "$(gain)"}] * 2


def test_a_quoted_value_that_an_include_gives_is_a_text(tmp_path: Path) -> None:
    arm = "arguments: {id: 1}\n" + component("{parameters: {id: $(id), n: 2}}")
    arm = arm.replace(TOP, "")
    for given, value in (("'007'", "007"), ("7", 7)):
        include = f"include: [{{file: arm.yaml, arguments: {{id: {given}}}}}]\n"
        (pilot,) = load(write(tmp_path, TOP + include, arm)).components()
        assert pilot.parameters == {"id": value, "n": 2}


def test_two_dollars_are_the_text(tmp_path: Path) -> None:
    text = component('{command: [sh, -c, "echo $$(date) $(date +%s)"]}')
    robot = load(write(tmp_path, text))
    assert robot.component("pilot").command[-1] == "echo $(date) $(date +%s)"


TWICE = """
include:
  - {file: arm.yaml, prefix: left_, arguments: {side: $(first), cpu: 20%}}
  - {file: arm.yaml, prefix: right_, arguments: {side: right}}
arguments: {first: left}
"""


def test_a_file_is_included_twice_under_other_names(tmp_path: Path) -> None:
    robot = load(write(tmp_path, component("{}") + TWICE))
    assert [(a.name, a.function) for a in robot.architectures[1:]] == [
        ("left_arm", "left_reach"),
        ("right_arm", "right_reach"),
    ]
    left, right = (robot.component(f"{side}_hand") for side in ("left", "right"))
    assert (left.demand["cpu"], right.demand["cpu"]) == (0.2, 0.05)
    assert left.devices == ("left_servo",)
    assert [d.path for d in robot.devices] == ["/dev/left", "/dev/right"]
    (inner,) = robot.architecture("right_arm").connectors
    assert inner.name == "right_eye-right_hand /right/seen"
    assert [c.name for c in robot.connectors] == [
        "left_hand-pilot",
        "right_hand-pilot",
    ]
    assert robot.chains[0].through == ("left_eye", "left_hand")
    assert robot.apart == (("left_eye", "left_hand"), ("right_eye", "right_hand"))


def test_an_argument_says_which_file_is_included(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / f"{side}.yaml").write_text(
            f"devices: {{{side}: {{computer: main, path: /d}}}}\n"
        )
    inner = "arguments: {side: left}\ninclude: [$(side).yaml]\n"
    path = write(tmp_path, TOP + inner)
    assert [d.name for d in load(path).devices] == ["left"]
    assert [d.name for d in load(path, {"side": "right"}).devices] == ["right"]
    outer = (
        "arguments: {which: right}\n"
        "include: [{file: arm.yaml, prefix: $(which)_, arguments: {side: $(which)}}]\n"
    )
    path = write(tmp_path, TOP + outer, inner)
    assert [d.name for d in load(path).devices] == ["right_right"]


def test_an_include_of_no_argument_is_told_where_it_is(tmp_path: Path) -> None:
    path = write(tmp_path, TOP + "include: [$(side).yaml]\n")
    (problem,) = problems(path)
    assert "there is no argument 'side': declare it" in problem.message
    assert problem.line == 3


def test_an_included_file_has_no_such_argument(tmp_path: Path) -> None:
    text = "include: [{file: arm.yaml, prefix: left_, arguments: {sid: left}}]\n"
    first = problems(write(tmp_path, component("{}") + text))[0]
    assert (first.line, first.column) == (5, 11)
    assert "no argument 'sid' (did you mean 'side'?)" in first.message


def test_a_file_with_a_prefix_has_no_tasks(tmp_path: Path) -> None:
    text = "include: [{file: arm.yaml, prefix: left_}]\n"
    arm = ARM + "tasks: {work: {actions: [{name: a, functions: [reach]}]}}\n"
    (problem,) = problems(write(tmp_path, component("{}") + text, arm))
    assert (Path(problem.file).name, problem.line) == ("arm.yaml", 18)
    assert "tasks: a file with a prefix has only 'arguments'" in problem.message


def test_files_that_include_each_other_with_prefixes_end(tmp_path: Path) -> None:
    arm = "include: [{file: arm.yaml, prefix: a_}]\n"
    text = "include: [{file: arm.yaml, prefix: b_}]\n"
    (problem,) = problems(write(tmp_path, component("{}") + text, arm))
    assert "the files include each other" in problem.message


def test_prefixes_that_double_at_each_level_end(tmp_path: Path) -> None:
    for level in range(20):
        twice = "".join(
            f"  - {{file: {level + 1}.yaml, prefix: {p}}}\n" for p in ("a_", "b_")
        )
        (tmp_path / f"{level}.yaml").write_text(f"include:\n{twice}")
    (tmp_path / "20.yaml").write_text("connectors: []\n")
    path = write(tmp_path, component("{}") + "include: [0.yaml]\n")
    assert any("more than 100 files" in p.message for p in problems(path))
