"""Connectors and chains."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers: {main: {cpu: 2, memory: 1}}
architectures:
  nav:
    function: f
    components: {a: {}, b: {}, c: {}}
    connectors: [{between: [a, b]}, NAV]
  ear: {function: g, components: {d: {}}}
"""


@pytest.mark.parametrize(
    ("connector", "words"),
    [
        ("{between: [a, ▸bb]}", ["no component 'bb'", "'a', 'b', 'c', 'd'"]),
        ("{between: [a, ▸d]}", ["'d' is not in architecture 'nav'", "`connectors`"]),
        ("▸{between: [a.x, a.y]}", ["a.x-a.y joins a component to itself"]),
        ("▸{between: [a, b]}", ["the connector a-b is defined twice"]),
    ],
)
def test_refuses_a_connector(refuse: Refuse, connector: str, words: list[str]) -> None:
    # A mapping in flow style is placed at its brace.
    refuse(ROBOT.replace("NAV", connector), *words)


def test_a_misspelt_end_is_one_problem_also_beside_a_chain(refuse: Refuse) -> None:
    text = ROBOT.replace("NAV", "{between: [b, ▸cc]}")
    refuse(f"{text}chains: {{p: {{through: [b, c], deadline: 1 s}}}}\n", "no component")


def test_accepts_a_connector_between_architectures(find: Find) -> None:
    text = ROBOT.replace(", NAV", "") + "connectors: [{between: [a.x, d.y]}]\n"
    assert find(text) == ()


@pytest.mark.parametrize(
    ("through", "words"),
    [
        ("[a, ▸zz]", ["no component 'zz'"]),
        ("[a, b, ▸c]", ["goes from 'b' to 'c'", "no connector"]),
        ("[b, a, ▸b]", ["'b' is listed twice"]),
    ],
)
def test_refuses_a_chain(refuse: Refuse, through: str, words: list[str]) -> None:
    text = ROBOT.replace(", NAV", "")
    refuse(f"{text}chains: {{p: {{through: {through}, deadline: 1 s}}}}\n", *words)
