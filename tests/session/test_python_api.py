"""The Python API: quick to import, and its results show themselves."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from math import inf, nan
from pathlib import Path
from typing import Any, cast

import pytest
from msgspec import structs

import poise
from poise.model import Architecture, ComponentEntry, Computer, Robot
from poise.model.robot import Action, Task
from poise.session.run_records import ComponentReport
from poise.session.run_report import RunReport
from poise.wire.records.status_records import Summary, TimerStatus
from tests.waiting import LONG

NOBODY = poise.Running("nobody")


def hello() -> Robot:
    left = Computer(name="left", capacity={"cpu": 1.0, "memory": 1.0})
    counter = ComponentEntry(name="counter", demand={"cpu": 0.5, "memory": 0.5})
    architecture = Architecture(name="a", function="a", components=(counter,))
    return Robot(name="hello", computers=(left,), architectures=(architecture,))


def greeter() -> Robot:
    greet = Action(name="greet", functions=("a",))
    return structs.replace(hello(), tasks=(Task(name="greet", actions=(greet,)),))


def report() -> RunReport:
    timer = TimerStatus(
        name="tick",
        period=0.1,
        deadline=0.1,
        releases=10,
        missed=1,
        lateness=Summary(),
        duration=Summary(count=10, mean=0.002, median=0.002, p99=0.003, maximum=0.004),
    )
    counter = ComponentReport(
        name="counter", computer="left", cpu=0.1, errors=0, timers=(timer,), measures={}
    )
    return RunReport(
        robot="hello",
        task="greet",
        method="auto",
        placement={"counter": "left"},
        decision_seconds=0.0,
        seconds=1.0,
        cpu_share={"left": 0.1},
        components=(counter,),
        connectors=(),
    )


def test_the_names_are_listed_before_they_are_imported() -> None:
    assert {"load", "place", "run", "up", "Component"} <= set(dir(poise))
    with pytest.raises(AttributeError, match="no attribute 'lode'"):
        _ = poise.lode  # type: ignore[attr-defined]


@pytest.mark.slow
def test_its_parts_are_there_without_an_import_of_their_own() -> None:
    parts = "emulate", "model", "plan", "testing", "units"
    code = f"import poise; [getattr(poise, part).__all__ for part in {parts}]"
    subprocess.run([sys.executable, "-c", code], timeout=LONG, check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loaded", "without"),
    [
        (
            "from poise import Component, every",
            ["zenoh", "rich", "typer", "yaml", "poise.plan"],
        ),
        # containers are forked from it
        (
            "import poise.cli.agent_command",
            ["rich", "yaml", "poise.model", "poise.plan"],
        ),
        # a command that asks a running robot, as `poise status` does
        (
            "import poise.cli.running_robot_command",
            [
                "numpy",
                "poise.emulate",
                "poise.manage.deploy",
                "poise.model.loading",
                "poise.plan.planner",
            ],
        ),
    ],
)
def test_nobody_loads_parts_that_are_not_used(loaded: str, without: list[str]) -> None:
    code = f"import sys; {loaded}; print([m for m in {without} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=LONG,
        check=True,
    )
    assert done.stdout == "[]\n"


def test_a_file_with_problems_is_an_error_with_all_of_them(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("robot: r\ncomputers: {a: {cup: 1}, b: {memroy: 1}}\n")
    with pytest.raises(poise.RobotError) as error:
        poise.load(file)
    text = " ".join(problem.message for problem in error.value.problems)
    assert "cup" in text
    assert "memroy" in text


def test_a_name_that_no_file_has_is_a_problem() -> None:
    (problem,) = poise.check("a\0b.yaml")
    assert "is not a file name" in problem.message


def test_a_placement_shows_where_components_are() -> None:
    placed = poise.place(hello())
    assert placed["counter"] == "left"
    assert str(placed.explain("counter")).startswith("counter is on left: ")
    for text in (str(placed), placed._repr_html_()):
        assert "counter" in text
        assert "left" in text


def test_a_wrong_name_is_a_wrong_argument() -> None:
    with pytest.raises(poise.UsageError, match="'hello' has no task 'dance'"):
        poise.place(hello(), "dance")
    with pytest.raises(
        poise.UsageError,
        match=r"no method 'fast' .*, round-robin, whole-functions, random:SEED, FILE\)",
    ):
        poise.place(hello(), method="fast")


def test_what_fits_nowhere_says_why_and_does_not_run() -> None:
    robot = hello()
    small = Computer(name="left", capacity={"cpu": 0.1, "memory": 1.0})
    robot = Robot(
        name="r",
        computers=(small,),
        architectures=robot.architectures,
        tasks=(
            Task(
                name="greet",
                actions=(
                    Action(
                        name="greet",
                        functions=tuple(a.function for a in robot.architectures),
                    ),
                ),
            ),
        ),
    )
    placed = poise.place(robot)
    assert not placed.feasible
    assert "cpu" in placed.reason
    with pytest.raises(poise.RobotError, match="no placement"):
        poise.run(robot, "greet", seconds=1.0, placement=placed)


def test_a_report_is_rows_of_plain_values() -> None:
    (row,) = report().rows("timers")
    assert (row["component"], row["timer"], row["missed"]) == ("counter", "tick", 1)
    assert row["duration_p99"] == 0.003
    assert "counter" in str(report())


@pytest.mark.slow
def test_a_report_is_a_data_frame() -> None:
    pytest.importorskip("pandas")
    frame = report().to_pandas("timers")
    assert list(frame["timer"]) == ["tick"]


WRONG_DURATIONS = [0.0, -1.0, float("nan"), float("inf"), "3 s", None]


@pytest.mark.parametrize("seconds", WRONG_DURATIONS)
def test_what_has_no_duration_or_no_end_is_not_begun(seconds: float) -> None:
    robot = greeter()
    with pytest.raises(poise.UsageError, match="a run"):
        poise.run(robot, seconds=seconds)
    with pytest.raises(poise.UsageError, match="a simulation"):
        poise.simulate(robot, seconds=seconds)
    with pytest.raises(poise.UsageError, match="a measurement"):
        poise.profile(robot, seconds=seconds)
    with pytest.raises(poise.UsageError, match="a measurement"):
        poise.calibrate(robot, seconds=seconds)


def test_a_file_is_no_robot() -> None:
    name = cast("Any", "robot.yaml")
    for call in (
        poise.place,
        poise.simulate,
        poise.profile,
        poise.calibrate,
        poise.deploy,
        poise.draw,
        partial(poise.run, seconds=1.0),
        lambda robot: poise.up(robot).__enter__(),
    ):
        with pytest.raises(poise.UsageError, match="is not a robot"):
            call(name)


def test_the_name_of_a_method_is_no_placement() -> None:
    robot, method = greeter(), cast("Any", "static")
    for call in (
        poise.simulate,
        partial(poise.run, seconds=1.0),
        lambda robot, placement: poise.up(robot, placement=placement).__enter__(),
    ):
        with pytest.raises(poise.UsageError, match="'static' is not a placement"):
            call(robot, placement=method)


def test_a_placement_of_another_task_is_refused() -> None:
    robot = greeter()
    (greet,) = robot.tasks
    wave = structs.replace(greet, name="wave")
    robot = structs.replace(robot, tasks=(greet, wave))
    placed = poise.place(robot, "wave")
    with pytest.raises(poise.UsageError, match="of task 'wave', not of 'greet'"):
        poise.run(robot, "greet", seconds=1.0, placement=placed)
    both = poise.up(robot, ["greet", "wave"], placement=placed)
    with pytest.raises(poise.UsageError, match="not of 'greet' and 'wave'"), both:
        pass


@pytest.mark.parametrize(
    "url",
    ["nonsense", "http://", "localhost:4318", "http://[::1:4318", "http://a:99999"],
)
def test_a_collector_has_a_url(url: str) -> None:
    with (
        pytest.raises(poise.UsageError, match="is no URL, as in http://localhost:4318"),
        poise.up(greeter(), otel=url),
    ):
        pass


def test_metrics_need_a_port() -> None:
    with (
        pytest.raises(poise.UsageError, match="port 65536: it is from 1 to 65535"),
        poise.up(greeter(), metrics=65536),
    ):
        pass


def test_only_up_starts_several_tasks() -> None:
    robot, tasks = greeter(), cast("Any", ["greet"])
    with pytest.raises(poise.UsageError, match="not the name of a task"):
        poise.place(robot, tasks)
    with pytest.raises(poise.UsageError, match="not the name of a task"):
        poise.run(robot, tasks, seconds=1.0)
    with pytest.raises(poise.UsageError, match="name a task"), poise.up(robot, []):
        pass


def test_a_file_may_be_named_by_a_string() -> None:
    with pytest.raises(poise.UsageError, match="there is no folder nowhere"):
        poise.run(greeter(), seconds=1.0, journal="nowhere/journal.jsonl")


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: poise.load(cast("Any", 3)), "file=3: it must be a path"),
        (lambda: poise.load("x", cast("Any", "a=b")), "arguments='a=b': it must be a"),
        (lambda: poise.check(cast("Any", None)), "file=None: it must be a path"),
        (lambda: poise.RecordedRun(cast("Any", 3)), "file=3: it must be a path"),
        (lambda: poise.place(hello(), method=cast("Any", 3)), "method=3: it must be"),
        (lambda: poise.place(hello(), seed=cast("Any", "x")), "seed='x': it must be a"),
        (lambda: poise.place(hello(), budget=cast("Any", "1")), "budget='1': it must"),
        (
            lambda: poise.simulate(greeter(), seed=cast("Any", "x")),
            "seed='x': it must be a whole number",
        ),
        (
            lambda: poise.simulate(greeter(), faults=cast("Any", ["cut"])),
            r"faults\[0\]='cut': it must be a `SimulatedFault`",
        ),
        (
            lambda: poise.compare_simulations(greeter(), methods="auto"),
            "methods='auto': it must be a list of names",
        ),
        (
            lambda: poise.draw(hello(), placements=cast("Any", {"now": 3})),
            r"placements\['now'\]=3: it must be component -> computer",
        ),
        (lambda: poise.draw(hello()).save(cast("Any", 3)), "path=3: it must be a path"),
        (lambda: poise.record("x", "a.b"), "connectors='a.b': it must be a list"),
        (lambda: poise.play("x", only="a.b"), "only='a.b': it must be a list of names"),
        (lambda: poise.play("x", rate=cast("Any", "2")), "rate='2': it must be a num"),
        (lambda: entered(poise.emulated(cast("Any", "x"))), "'x' is not a robot"),
        (lambda: entered(poise.up(greeter(), cast("Any", 3))), "task=3: it must be"),
        (
            lambda: entered(poise.up(greeter(), metrics=cast("Any", "80"))),
            "metrics='80': it must be a port",
        ),
        (
            lambda: entered(poise.up(greeter(), record=cast("Any", 3))),
            "record=3: it must be a path",
        ),
        (lambda: poise.stop_without_manager(cast("Any", "x")), "'x' is not a robot"),
        (lambda: NOBODY.replace("a", "b", watch=nan), "watch=nan: it must be 0 or mo"),
        (lambda: NOBODY.balance(cost=-1.0), "cost=-1.0: it must be 0 or more"),
        (lambda: next(NOBODY.echo("a.b", rate=inf)), "rate=inf: .* and finite"),
        (lambda: NOBODY.tasks.wait("a", cast("Any", "9")), "seconds='9': it must be"),
    ],
)
def test_an_argument_of_another_type_is_named(
    call: Callable[[], object], says: str
) -> None:
    with pytest.raises(poise.UsageError, match=says):
        call()


def entered(manager: AbstractContextManager[object]) -> None:
    with manager:
        pytest.fail("it should have been refused")
