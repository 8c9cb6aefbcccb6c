"""Faults of a file: what it may say, and where in the file it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.errors import RobotError, UsageError
from poise.model.robot import Computer, Robot
from poise.session.fault_file import faults_of, read_faults
from poise.simulation.faults import KINDS, LINK_KINDS, SimulatedFault

ROBOT = Robot(
    name="r", computers=tuple(Computer(name=each) for each in ("main", "vision"))
)
ALONE = Robot(name="r", computers=ROBOT.computers[:1])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "faults.yaml"


def problems(path: Path, line: str, seconds: float = 3600.0) -> list[str]:
    """Return the problems of a file with one fault, without the file's name."""
    path.write_text(f"faults:\n  - {line}\n")
    with pytest.raises(RobotError) as error:
        read_faults(path, ROBOT, seconds)
    return [str(each).removeprefix(f"{path}:") for each in error.value.problems]


def test_a_file_has_faults_of_computers_and_links(path: Path) -> None:
    path.write_text("""\
faults:
  - {at: 10 min, fault: isolate computer, computer: vision, for: 30 s}
  - {at: 15 min, fault: cut one way, between: [vision, main], for: 500 ms}
  - {at: 20 min, fault: kill container, computer: main, pick: 0.5}
  - {at: 0, fault: lose datagrams, for: 5 s}
""")
    assert faults_of(ROBOT, path, 3600.0, seed=0) == (
        SimulatedFault(600.0, "isolate computer", "vision", lasts=30.0),
        SimulatedFault(900.0, "cut one way", "vision", "main", lasts=0.5),
        SimulatedFault(1200.0, "kill container", "main", lasts=1.0, pick=0.5),
        SimulatedFault(0.0, "lose datagrams", "main", lasts=5.0),
    )


@pytest.mark.parametrize(
    ("line", "word", "what"),
    [
        (
            "{at: 1 s, fault: kill agent, computer: mian, for: 1 s}",
            "computer",
            "there is no computer 'mian' (did you mean 'main'?)",
        ),
        (
            "{at: 1 s, fault: cut link, between: [main, vison], for: 1 s}",
            "vison",
            "(did you mean 'vision'?)",
        ),
        (
            "{at: 1 s, fault: cut link, between: [vision, main], at: 2 s, for: 1 s}",
            "at: 2 s",
            "is defined twice",
        ),
        (
            "{at: 1 s, fault: kil agent, computer: main, for: 1 s}",
            "fault",
            "(did you mean 'kill agent'?)",
        ),
        ("{at: -1 s, fault: kill agent, computer: main, for: 1 s}", "at", "negative"),
        (
            "{at: 1 h, fault: kill agent, computer: main, for: 1 s}",
            "at",
            "begins at 3600 s, but 3600 s are simulated",
        ),
        (
            "{at: 1 s, fault: kill agent, computer: main, for: 0 s}",
            "for",
            "must be above 0",
        ),
        (
            "{at: 1 s, fault: kill agent, computer: main, four: 1 s}",
            "four",
            "unknown key 'four' (did you mean 'for'?)",
        ),
        ("{at: 1 s, fault: kill agent, computer: main}", "{", "lacks the key 'for'"),
        (
            "{at: 1 s, fault: kill container, computer: main, for: 1 s}",
            "for",
            "takes no 'for'",
        ),
        (
            "{at: 1 s, fault: cut link, computer: main, for: 1 s}",
            "{",
            "lacks the key 'between'",
        ),
        (
            "{at: 1 s, fault: kill agent, between: [main, vision], for: 1 s}",
            "{",
            "lacks the key 'computer'",
        ),
        (
            "{at: 1 s, fault: lose datagrams, computer: main, for: 1 s}",
            "computer",
            "takes no 'computer'",
        ),
    ],
)
def test_what_is_wrong_is_said_where_it_is(
    path: Path, line: str, word: str, what: str
) -> None:
    where = f"2:{len('  - ') + line.index(word) + 1}: "
    found = problems(path, line)
    assert [each for each in found if each.startswith(where) and what in each], found


def test_a_link_is_between_two_computers(path: Path) -> None:
    line = "{at: 1 s, fault: cut link, between: [main, main], for: 1 s}"
    (problem,) = problems(path, line)
    assert "a link is between two computers, not from 'main' back" in problem


def test_all_problems_are_said_at_once(path: Path) -> None:
    path.write_text("""\
faults:
  - {at: 1 s, fault: kill agent, computer: left, for: 1 s}
  - {at: 2 h, fault: kill container, computer: main, for: 1 s}
  - {at: 1 s, fault: kil agent, computer: main, for: 1 s}
  - {at: 1 s, fault: kill agent, computer: left, for: soon, four: 1 s}
  - {at: 2 h, fault: cut link, computer: left, for: 1 s}
""")
    with pytest.raises(RobotError) as error:
        read_faults(path, ROBOT, 3600.0)
    said = [str(each).partition(": ")[2] for each in error.value.problems]
    lines = [each.line for each in error.value.problems]
    assert lines == [2, 3, 3, 4, 5, 5, 5, 6, 6, 6], said


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError) as error:
        faults_of(ROBOT, tmp_path, 60.0, seed=0)
    assert str(error.value) == f"{tmp_path}: is a folder, not a file"


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "the file is empty"),
        ("fault: []", "the key 'faults' is missing"),
        ("- 1", "must be a mapping with 'faults'"),
        ("faults: {", "not YAML"),
    ],
)
def test_another_file_is_refused(path: Path, text: str, what: str) -> None:
    path.write_text(text)
    with pytest.raises(RobotError, match=what):
        read_faults(path, ROBOT, 60.0)


def test_a_file_that_is_not_there_is_refused(path: Path) -> None:
    with pytest.raises(RobotError, match="does not exist"):
        faults_of(ROBOT, str(path), 60.0, seed=0)


def test_a_seed_picks_the_same_faults_again() -> None:
    one, again, other = (faults_of(ROBOT, "random", 3600.0, seed) for seed in (1, 1, 2))
    assert one == again != other


def test_random_faults_are_rare_and_within_the_time() -> None:
    """An hour has a fault every 5 min in the mean, ten minutes one every 100 s."""
    for seconds, mean in ((3600.0, 12), (600.0, 6)):
        several = [faults_of(ROBOT, "random", seconds, seed) for seed in range(100)]
        assert mean * 0.8 < sum(map(len, several)) / 100 < mean * 1.2
        assert all(f.at + f.lasts < seconds for each in several for f in each)


def test_a_computer_that_is_alone_has_no_faults_of_links() -> None:
    several = [faults_of(ALONE, "random", 3600.0, seed) for seed in range(50)]
    kinds = {fault.kind for each in several for fault in each}
    assert kinds
    assert not kinds & {*LINK_KINDS}
    assert kinds <= {*KINDS}


def test_faults_that_are_given_are_checked() -> None:
    fault = SimulatedFault(1.0, "clog link", "main", "left", lasts=-1.0)
    with pytest.raises(UsageError) as error:
        faults_of(ROBOT, [fault], 60.0, seed=0)
    assert "lasts -1 s" in str(error.value)
    assert "there is no computer 'left'" in str(error.value)
