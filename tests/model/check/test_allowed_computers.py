"""Components that may run nowhere, and demands that fit nowhere."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers:
  main: {cpu: 2, memory: 1 GiB, speed: 0.5, reserve: 10%}
  vision: {cpu: 2, memory: 2 GiB, resources: {gpu: 1}}
devices:
  laser: {computer: main}
  camera: {computer: vision}
architectures:
  nav: {function: f, components: {a: {COMPONENT}}}
"""


@pytest.mark.parametrize(
    ("component", "words"),
    [
        (
            "devices: [laser, camera]",
            [
                "'a' cannot run on any computer",
                "device laser is on main",
                "device camera is on vision",
            ],
        ),
        (
            "devices: [laser], only: [vision]",
            ["device laser is on main", "only vision"],
        ),
    ],
)
def test_refuses_a_component_that_may_run_nowhere(
    refuse: Refuse, component: str, words: list[str]
) -> None:
    text = ROBOT.replace("{a: {COMPONENT}", f"{{▸a: {{{component}}}")
    refuse(text, *words)


def test_a_reactive_component_cannot_need_a_device_elsewhere(refuse: Refuse) -> None:
    text = ROBOT.replace("{a: {COMPONENT}", "{▸a: {devices: [camera]}")
    text = text.replace("function: f", "function: f, layer: reactive, home: main")
    refuse(text, "the reactive layer stays at its home main")


@pytest.mark.parametrize(
    ("component", "words"),
    [
        ("▸cpu: 2.1", ["needs 2.1 cores of cpu", "'vision', has 2 cores usable"]),
        # 2 cores x 0.5 - 10% = 0.9 cores
        ("only: [main], ▸cpu: 1", ["needs 1 core of cpu", "'main', has 0.9 cores"]),
        ("devices: [laser], ▸memory: 1 GiB", ["'main', has 922 MiB usable"]),
        ("resources: {▸gpu: 2}", ["needs 2 of gpu", "has 1 usable"]),
        ("only: [main], resources: {▸gpu: 1}", ["'main', has 0 usable"]),
    ],
)
def test_refuses_a_demand_that_is_larger_than_every_allowed_computer(
    refuse: Refuse, component: str, words: list[str]
) -> None:
    refuse(ROBOT.replace("COMPONENT", component), *words)


def test_accepts_a_demand_that_fills_a_computer(find: Find) -> None:
    assert find(ROBOT.replace("COMPONENT", "only: [main], cpu: 90%")) == ()


def test_an_alternative_that_is_too_large_leaves_the_others(find: Find) -> None:
    text = """
robot: r
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  big: {function: see, components: {eye: {cpu: 2}}}
  small: {function: see, quality: 0.5, components: {lid: {cpu: 0.5}}}
"""
    assert not find(text)
    found = find(text.replace("0.5}}", "1.5}}"))
    assert [each.line for each in found] == [5, 6]
    assert "component 'lid' needs 1.5 cores" in str(found[1])
