"""`together` and `apart`."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers: {main: {cpu: 2, memory: 1}, vision: {cpu: 2, memory: 1}}
architectures:
  nav:
    function: f
    components:
      {a: {only: [main]}, b: {only: [main]}, c: {only: [vision]}, d: {}, e: {}}
"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("together: [[a, ▸aa]]", ["no component 'aa'"]),
        ("apart: [[d, ▸d]]", ["'d' is listed twice"]),
        ("together: [▸[a, c]]", ["no computer", "'a' on 'main'; 'c' on 'vision'"]),
        ("together: [[a, d], [e, c], ▸[d, e]]", ["'a' on 'main'", "'c' on 'vision'"]),
        ("apart: [▸[a, b]]", ["'a' and 'b'", "both can run only on 'main'"]),
        ("together: [[d, e]]\napart: [▸[d, e]]", ["`together` puts them"]),
        ("together: [[a, d], [d, e]]\napart: [▸[a, e]]", ["'a' and 'e'"]),
        ("apart: [▸[a, d, c]]", ["3 components", "only 2"]),
    ],
)
def test_refuses_sets_that_cannot_hold(
    refuse: Refuse, text: str, words: list[str]
) -> None:
    refuse(ROBOT + text + "\n", *words)


def test_accepts_sets_that_can_hold(find: Find) -> None:
    assert find(ROBOT + "together: [[a, b], [c, d]]\napart: [[a, c], [d, e]]\n") == ()
