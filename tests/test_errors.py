"""Problems and the error that carries them."""

from poise.errors import FileProblem, RobotError


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
