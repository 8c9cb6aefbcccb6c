"""YAML text becomes a tree that knows its places, or a problem."""

import time

import pytest

from poise.errors import FileProblem
from poise.model.yaml_tree import DEEPEST, MOST, Location, Node, Scalar, parse


def tree(text: str) -> tuple[Node | None, list[FileProblem]]:
    problems: list[FileProblem] = []
    return parse(text, "r.yaml", problems), problems


def test_every_value_knows_the_place_of_its_key() -> None:
    root, problems = tree("a:\n  b: [x,\n      y]\n")
    assert not problems
    assert root == Node(
        Location("r.yaml", 1, 1),
        {
            "a": Node(
                Location("r.yaml", 1, 1),
                {
                    "b": Node(
                        Location("r.yaml", 2, 3),
                        [
                            Node(Location("r.yaml", 2, 7), Scalar("x", plain=True)),
                            Node(Location("r.yaml", 3, 7), Scalar("y", plain=True)),
                        ],
                    )
                },
            )
        },
    )


@pytest.mark.parametrize(
    ("text", "line", "column", "words"),
    [
        ("", 1, 1, "the file is empty"),
        ("# only a comment\n", 1, 1, "the file is empty"),
        ("a: [1, 2\nb: 3\n", 2, 2, "not YAML"),
        ("a: 1\n b: 2\n", 2, 3, "is it indented too far, or is a `{`"),
        ("a:\n\tb: 1\n", 2, 1, "is it a tab"),
        ("a: 1\n---\nb: 2\n", 2, 1, "expected a single document"),
        (
            "a: 1\nb: 2\na: 3\n",
            3,
            1,
            "the key 'a' is defined twice, first at r.yaml:1:1",
        ),
        ("a: *nothing\n", 1, 4, "the alias *nothing has no anchor"),
        ("é: 1\nb: \x07\n", 2, 4, "special characters are not allowed"),
        ("? [a]\n: 1\n", 1, 3, "a key must be a word"),
        ("a: !!python/name:os.system\n", 1, 1, "YAML tags are not supported"),
        ("a: !mine 3\n", 1, 1, "YAML tags are not supported: '!mine'"),
        ("a: !!str 3\n", 1, 1, "not supported: '!!str'; a text goes in quotes"),
        ("a: ! 3\n", 1, 1, "YAML tags are not supported: '!'"),
        ("a: {<<: {b: 1}, c: 2}\n", 1, 5, "merge keys (<<) are not supported"),
        ('a: "\\0"\n', 1, 1, "a character that is not allowed"),
        ('a: "\\ud800"\n', 1, 7, "not YAML"),
        ('a: "\\UFFFFFFFF"\n', 1, 7, "not YAML"),
        ("a: &x [*x]\n", 1, 8, "the alias *x contains itself"),
    ],
)
def test_what_is_no_tree_is_a_problem_at_its_place(
    text: str, line: int, column: int, words: str
) -> None:
    _, problems = tree(text)
    assert len(problems) == 1, problems
    assert problems[0].file == "r.yaml"
    assert (problems[0].line, problems[0].column) == (line, column), problems
    assert words in problems[0].message


def test_nesting_has_a_limit() -> None:
    root, problems = tree("[" * 500)
    assert root is None
    assert f"more than {DEEPEST} levels" in problems[0].message
    assert problems[0].column == DEEPEST + 1


@pytest.mark.slow
def test_aliases_cannot_grow_a_small_file_into_a_huge_tree() -> None:
    # 10^9 values when expanded
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    for i in range(1, 9):
        items = ", ".join([f"*a{i - 1}"] * 10)
        lines.append(f"a{i}: &a{i} [{items}]")
    root, problems = tree("\n".join(lines))
    assert root is None
    assert f"more than {MOST} values" in problems[0].message


def test_nesting_without_end_is_refused() -> None:
    root, problems = tree("[" * 100_000)
    assert (root, len(problems)) == (None, 1)


@pytest.mark.slow
def test_a_large_file_is_read_soon() -> None:
    """It took 25 us for each value where PyYAML's own parser made the events."""
    text = "\n".join(f"c{i}: {{cpu: 1, memory: 1}}" for i in range(20_000))
    began = time.process_time()
    root, problems = tree(text)
    assert root is not None
    assert isinstance(root.value, dict)
    assert (len(root.value), problems) == (20_000, [])
    assert time.process_time() - began < 1.5


def test_an_alias_stands_for_its_anchor() -> None:
    root, problems = tree("a: &x {k: 1}\nb: *x\n")
    assert not problems
    assert root is not None
    assert isinstance(root.value, dict)
    assert root.value["b"].value == root.value["a"].value
    assert root.value["b"].value is not root.value["a"].value
