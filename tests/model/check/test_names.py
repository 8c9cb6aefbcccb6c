"""Names that nobody has, and names that two have."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers:
  main: {cpu: 2, memory: 1 GiB}
  vision: {cpu: 2, memory: 1 GiB}
devices:
  laser: {computer: main}
architectures:
  nav:
    function: navigation
    components:
      scanner: {devices: [laser]}
      localiser: {}
    connectors:
      - {between: [scanner, localiser]}
  ear:
    function: audition
    components:
      listener: {}
"""


def test_accepts_names_that_exist(find: Find) -> None:
    assert find(ROBOT + "tasks: {t: {actions: []}}".replace("[]", "[{name: a, "
                "functions: [navigation, audition]}]")) == ()  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "laser: {computer: main}",
            "laser: {▸computer: vison}",
            ["no computer 'vison'", "did you mean 'vision'?", "'main', 'vision'"],
        ),
        ("devices: [laser]", "devices: [▸lasr]", ["no device 'lasr'", "'laser'"]),
        ("devices: [laser]", "devices: [laser, ▸laser]", ["'laser' is listed twice"]),
        ("localiser: {}", "localiser: {only: [▸mian]}", ["no computer 'mian'"]),
        (
            "function: audition",
            "function: audition\n    ▸home: mainn",
            ["no computer 'mainn'"],
        ),
        (
            "  ear:\n",
            "  ▸ear:\n    layer: reactive\n",
            ["'ear' is in the reactive layer", "needs a `home`"],
        ),
        (
            "listener: {}",
            "▸scanner: {}",
            ["component 'scanner' in architecture 'nav' already", "robot-wide"],
        ),
        (
            "listener: {}",
            "listener: {implementation: 'a:B', ▸command: x}",
            ["'listener' has an implementation and a command"],
        ),
        (
            "listener: {}",
            "listener: {implementation: 'a:B', ▸ports: {p: {publishes: 'a:C'}}}",
            ["its class declares its ports"],
        ),
    ],
)
def test_refuses_in_a_section(
    refuse: Refuse, old: str, new: str, words: list[str]
) -> None:
    assert ROBOT.count(old) == 1
    refuse(ROBOT.replace(old, new), *words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("links: [{between: [main, ▸vison]}]", ["no computer 'vison'"]),
        ("links: [{▸between: [main, main]}]", ["a link joins 'main' to itself"]),
        (
            "links: [{between: [main, vision]}, {▸between: [vision, main]}]",
            ["two links between 'vision' and 'main'"],
        ),
        (
            "tasks: {t: {actions: [{name: a, functions: [▸navigtion]}]}}",
            ["no function 'navigtion'", "'navigation'?", "'audition'"],
        ),
        ("objective: {weights: {▸gpu: 1}}", ["no resource 'gpu'", "'memory'"]),
        ("objective: {sizes: {▸gpu: 1}}", ["no resource 'gpu'"]),
        ("workload: {generate: {▸eer: {rate: 1 Hz}}}", ["no component 'eer'"]),
    ],
)
def test_refuses_a_section(refuse: Refuse, text: str, words: list[str]) -> None:
    refuse(ROBOT + text + "\n", *words)


def test_refuses_an_architecture_that_would_never_run(refuse: Refuse) -> None:
    text = ROBOT.replace("    function: nav", "    ▸function: nav").replace(
        "function: audition",
        "function: navigation\n    layer: reactive\n    home: main",
    )
    refuse(text, "'nav' would never run", "'ear' of the reactive layer")


def test_refuses_a_reserve_of_what_the_computer_lacks(refuse: Refuse) -> None:
    text = ROBOT.replace("main: {cpu: 2,", "main: {reserve: {▸gpu: 5%}, cpu: 2,")
    refuse(text, "no resource 'gpu'", "'cpu', 'memory'")
