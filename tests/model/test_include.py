"""Robot files that include others."""

from pathlib import Path

import pytest

from poise.errors import FileProblem, RobotError
from poise.model import load

COMPUTERS = "computers: {main: {cpu: 1, memory: 1 GiB}}\n"


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        path = folder / f"{name}.yaml"
        path.write_text(text)
    return folder / "robot.yaml"


def problems(path: Path) -> list[FileProblem]:
    with pytest.raises(RobotError) as error:
        load(path)
    return list(error.value.problems)


def test_sections_of_included_files_are_merged(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    write(
        tmp_path / "parts",
        nav="""include: [shared.yaml]
architectures: {nav: {function: f, components: {a: {}}}}
apart: [[a, b]]
objective: {balance: 2}
""",
        shared="computers: {vision: {cpu: 1, memory: 1 GiB}}\n",
        audio="""include: [shared.yaml]
architectures: {audio: {function: g, components: {b: {}}}}
apart: [[b, a]]
""",
    )
    robot = load(
        write(
            tmp_path,
            robot="robot: r\ninclude: [parts/nav.yaml, parts/audio.yaml]\n"
            f"{COMPUTERS}objective: {{communication: 3}}\n",
        )
    )
    assert [c.name for c in robot.computers] == ["main", "vision"]
    assert [a.name for a in robot.architectures] == ["nav", "audio"]
    assert robot.apart == (("a", "b"), ("b", "a"))
    assert (robot.objective.communication, robot.objective.balance) == (3, 2)
    assert robot.folder == str(tmp_path)


@pytest.mark.parametrize("include", ["nav.yaml", "{file: nav.yaml, prefix: a_}"])
def test_what_an_included_file_includes_is_a_list(tmp_path: Path, include: str) -> None:
    path = write(
        tmp_path,
        robot=f"robot: r\ninclude: [{include}]\n{COMPUTERS}",
        nav="\ninclude: more.yaml\n",
        more="devices: {arm: {computer: main}}\n",
    )
    (found,) = problems(path)
    assert (found.file, found.line) == (str(tmp_path / "nav.yaml"), 2)
    assert found.message == "include: must be a list, as in [a, b], not 'more.yaml'"


def test_an_unknown_key_of_an_include_is_told_once(tmp_path: Path) -> None:
    include = "include: [{file: nav.yaml, prefx: a_}]\n"
    path = write(tmp_path, robot=f"robot: r\n{include}{COMPUTERS}", nav="links: []\n")
    (found,) = problems(path)
    assert "unknown key 'prefx' (did you mean 'prefix'?)" in found.message


def test_a_problem_in_an_included_file_is_told_at_its_place(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        robot=f"robot: r\ninclude: [nav.yaml]\n{COMPUTERS}",
        nav="\narchitectures:\n  nav: {function: f, home: mian, components: {}}\n",
    )
    (problem,) = problems(path)
    assert (problem.file, problem.line) == (str(tmp_path / "nav.yaml"), 3)
    assert problem.column == 22
    assert "there is no computer 'mian' (did you mean 'main'?)" in problem.message


def test_a_circle_is_told_with_the_files_on_it(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        robot=f"robot: r\ninclude: [a.yaml]\n{COMPUTERS}",
        a="include:\n  - b.yaml\n",
        b="include: [robot.yaml]\n",
    )
    (problem,) = problems(path)
    assert (problem.file, problem.line) == (str(tmp_path / "b.yaml"), 1)
    assert problem.column == 11
    assert "robot.yaml -> a.yaml -> b.yaml -> robot.yaml" in problem.message


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("missing.yaml", "include: 'missing.yaml' does not exist"),
        (".", "is a folder"),
        ("[x]", "include: must be a single value, not a list of 1"),
        ("{fil: x}", "include: the key 'file' is missing"),
        ('"a\\nb.yaml"', "does not exist"),
        ("x" * 5000, "cannot be read: File name too long"),
    ],
)
def test_what_cannot_be_included_is_told_where_it_is_named(
    tmp_path: Path, entry: str, words: str
) -> None:
    path = write(tmp_path, robot=f"robot: r\n{COMPUTERS}include:\n  - {entry}\n")
    problem = problems(path)[0]
    assert (problem.line, problem.column) == (4, 5)
    assert words in problem.message


def test_what_may_be_in_a_file_that_cannot_be_included_is_not_missing(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, robot="include: [computer.yaml]\n")
    (problem,) = problems(path)
    assert problem.message == "include: 'computer.yaml' does not exist"


def test_what_is_given_twice_is_told_with_the_first_place(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        robot=f"robot: r\ninclude: [more.yaml]\n{COMPUTERS}",
        more="robot: s\ncomputers: {main: {cpu: 1, memory: 1}}\ntasks: [x]\n",
    )
    found = problems(path)
    first, second = found[:2]
    assert (first.line, first.column) == (1, 1)
    assert f"robot is defined twice, first at {path}:1:1" in first.message
    assert (second.line, second.column) == (2, 13)
    assert "computers.main is defined twice" in second.message


def test_the_number_of_files_has_a_limit(tmp_path: Path) -> None:
    names = [f"f{i}" for i in range(101)]
    included = ", ".join(f"{name}.yaml" for name in names)
    text = f"robot: r\n{COMPUTERS}include: [{included}]\n"
    path = write(tmp_path, robot=text, **dict.fromkeys(names, "apart: []\n"))
    assert "more than 100 files" in problems(path)[0].message
