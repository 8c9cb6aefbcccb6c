"""Policies of a robot file: what is wrong with them, and what they change."""

from __future__ import annotations

from pathlib import Path

from poise.model import load
from poise.model.policy import policies_of, shipped
from tests.model.conftest import Find, Refuse

ROBOT = """
robot: r
computers: {left: {cpu: 1, memory: 1 GiB}}
policies:
  """


def test_an_unknown_value_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: component, ▸when: memry > 3 MiB, do: notify}"
    refuse(ROBOT + text, "there is no value 'memry' (did you mean 'memory'?)")


def test_an_unknown_name_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: computer, ▸when: name == 'lefd', do: notify}"
    refuse(ROBOT + text, "'lefd' is none of 'left' (did you mean 'left'?)")


def test_an_unknown_subject_is_found(refuse: Refuse) -> None:
    text = "mine: {▸for each: componet, when: lost, do: notify}"
    refuse(ROBOT + text, "did you mean 'component'?")


def test_an_unknown_action_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: computer, when: lost, ▸do: notfy}"
    refuse(ROBOT + text, "did you mean 'notify'?")


def test_what_is_wrong_is_not_said_to_be_missing(refuse: Refuse) -> None:
    move = "mine: {for each: component, when: cpu > 1, do: move, ▸to: my left}"
    refuse(ROBOT + move, "'my left' is not allowed; write a letter")
    refuse(ROBOT + "mine: {▸call: policy}", "write package.module:function")


def test_an_action_for_another_subject_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: timer, when: late, ▸do: fail over}"
    refuse(ROBOT + text, "'fail over' is done for each 'computer', not for each")


def test_a_sentence_with_an_unknown_value_is_found(refuse: Refuse) -> None:
    refuse(ROBOT + "overload: {▸say: '{nam} is full'}", "{nam} is not a value")


def test_what_a_policy_lacks_is_found(refuse: Refuse) -> None:
    text = "▸mine: {for each: timer, when: late}"
    refuse(ROBOT + text, "a policy of your own needs 'do'")


def test_only_shipped_policies_are_switched_off(refuse: Refuse) -> None:
    refuse(
        ROBOT + "▸overlaod: off",
        "did you mean 'overload'?",
        "policies: 'overload', 'deadlines', 'drift'",
    )


def test_the_shipped_policies_are_right(find: Find) -> None:
    as_own = "\n  ".join(
        line
        for line in (Path("src/poise/model/shipped_policies.yaml"))
        .read_text(encoding="utf-8")
        .splitlines()
        if not line.startswith("#")
    )
    assert find(ROBOT + as_own) == ()


def test_a_robot_file_changes_what_it_names(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        ROBOT + "overload: off\n  deadlines: {lasts: 2 s}\n"
        "  mine: {for each: robot, when: late > 3, do: notify, cool down: 1 min}\n"
    )
    found = {policy.name: policy for policy in policies_of(load(path).policies)}
    assert found["overload"].off
    assert found["deadlines"].lasts == 2.0
    assert found["deadlines"].when == "late"
    assert found["mine"].lasts == 0.5
    assert found["mine"].cool_down == 60.0
    assert found["mine"].say == "robot '{name}': late > 3"
    assert list(found)[: len(shipped())] == [policy.name for policy in shipped()]


def test_a_move_to_no_computer_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: timer, when: late, do: move, ▸to: lefd}"
    refuse(ROBOT + text, "there is no computer 'lefd' (did you mean 'left'?)")


def test_a_move_without_a_computer_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: timer, when: late, ▸do: move}"
    refuse(ROBOT + text, "'move' needs 'to', a computer")


def test_a_function_decides_alone(refuse: Refuse) -> None:
    text = "mine: {call: 'a:b', ▸when: late}"
    refuse(ROBOT + text, "a policy with `call` has no 'when': its function decides")


def test_a_function_may_take_the_place_of_a_shipped_policy(find: Find) -> None:
    assert find(ROBOT + "drift: {call: 'a:b'}") == ()


ARCHITECTURES = """
architectures:
  best: {function: f, components: {a: {}}}
  other: {function: f, components: {b: {}}}
  alone: {function: g, components: {c: {}}}"""


def test_a_replacement_that_nothing_can_undergo_is_found(
    find: Find, refuse: Refuse
) -> None:
    text = "mine: {for each: component, when: hung > 1 s, ▸do: replace}"
    refuse(ROBOT + text, "no function has two architectures, so nothing can be")
    assert find(ROBOT + text.replace("▸", "") + ARCHITECTURES) == ()
    by = "mine: {for each: component, when: hung > 1 s, do: replace, ▸by: alone}"
    refuse(ROBOT + by + ARCHITECTURES, "'alone' alone provides 'g', so it can replace")


def test_a_target_of_another_action_is_found(refuse: Refuse) -> None:
    text = "mine: {for each: timer, when: late, do: notify, ▸to: left}"
    refuse(ROBOT + text, "'to' is for 'move', not 'notify'")
