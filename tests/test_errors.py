"""Problems and the error that carries them."""

import os

import pytest

from poise.errors import FileProblem, RobotError, encodable, last_error, signal_name
from poise.runtime.component.error_report import traceback_of
from poise.runtime.supervision.container_processes import ProcessEnd
from poise.wire import frame


def test_a_problem_starts_with_its_place() -> None:
    assert str(FileProblem("r.yaml", 3, 7, "is wrong")) == "r.yaml:3:7: is wrong"


def test_a_problem_of_a_whole_file_has_no_line() -> None:
    assert (
        str(FileProblem("r.yaml", 0, 0, "does not exist")) == "r.yaml: does not exist"
    )


def test_a_robot_error_tells_every_problem() -> None:
    problems = [FileProblem("r.yaml", 1, 2, "a"), FileProblem("r.yaml", 3, 4, "b")]
    error = RobotError(problems=problems)
    assert str(error) == "r.yaml:1:2: a\nr.yaml:3:4: b"
    assert error.problems == tuple(problems)


def test_what_cannot_be_encoded_is_written_out() -> None:
    text = os.fsdecode(b"map-\xff.png")
    assert encodable(text) == "map-\\udcff.png"
    error = ValueError(text)
    assert "map-" in str(frame.failure("ValueError", text, traceback_of(error)))


def test_each_signal_has_a_name_for_people() -> None:
    assert (signal_name(9), signal_name(40)) == ("SIGKILL", "signal 40")
    assert str(ProcessEnd(40)) == "was killed by signal 40"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            'Traceback:\n  File "a.py", line 3\n    f()\nValueError: no',
            "ValueError: no",
        ),
        ('  File "a.py", line 3\nValueError: no\nnor yes', "ValueError: no ..."),
        ("the disk is full\n", "the disk is full"),
        ("", ""),
    ],
)
def test_an_error_is_told_by_its_type_and_first_line(text: str, says: str) -> None:
    assert last_error(text) == says
