"""Problems and the error that carries them."""

from poise.errors import Problem, RobotError


def test_a_problem_starts_with_its_place() -> None:
    assert str(Problem("r.yaml", 3, 7, "is wrong")) == "r.yaml:3:7: is wrong"


def test_a_problem_of_a_whole_file_has_no_line() -> None:
    assert str(Problem("r.yaml", 0, 0, "does not exist")) == "r.yaml: does not exist"


def test_a_robot_error_tells_every_problem() -> None:
    problems = [Problem("r.yaml", 1, 2, "a"), Problem("r.yaml", 3, 4, "b")]
    error = RobotError(problems=problems)
    assert str(error) == "r.yaml:1:2: a\nr.yaml:3:4: b"
    assert error.problems == tuple(problems)
