"""Components in C++ do what components in Python do, and with them."""

from __future__ import annotations

import ctypes
import importlib
import math
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
import pytest
from msgspec import structs
from numpy.typing import NDArray

import poise
from examples.demo.waiting import measures
from poise import (
    CalleeError,
    CannotCross,
    Component,
    Message,
    Provided,
    Published,
    Required,
    Stamp,
    Timeout,
    cmake,
    oneway,
    subscribed,
)
from poise.errors import UsageError
from poise.runtime.component.component import set_parameters
from poise.runtime.component.implementation import fingerprint
from poise.runtime.component.ports import ports_of
from poise.runtime.execution.exclusion import new_chain
from poise.session.placing.placement import place
from poise.testing import Bench
from poise.wire.records.request_records import PROTOCOL
from tests.command import called
from tests.release import environment, make_release
from tests.runtime.conftest import Pair, every_kind, pair
from tests.waiting import LIMIT, LONG, wait_long, wait_until

__all__ = ["pair"]
pytestmark = [pytest.mark.exhaustive, pytest.mark.slow]
ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples/cpp"


class Point(Message):
    x: float
    y: float


class Everything(Message):
    number: int
    real: float
    flag: bool
    text: str
    points: list[Point]
    maybe: str | None
    named: dict[str, float]
    two: tuple[float, float]
    raw: bytes
    array: NDArray[np.float32]
    at: Stamp


class Number(Message):
    value: int


class Sums(Protocol):
    def add(self, one: int, two: int) -> int: ...

    def echo(self, everything: Everything) -> Everything: ...

    def fail(self, why: str) -> None: ...

    def wait(self, seconds: float) -> None: ...

    def back(self, depth: int) -> int: ...

    @oneway
    def note(self, text: str) -> None: ...


class Backs(Protocol):
    def further(self, depth: int) -> int: ...


class Target(Component):
    sums: Provided[Sums]
    backs: Required[Backs]
    heard: Published[Number]

    def add(self, one: int, two: int) -> int:
        return one + two

    def echo(self, everything: Everything) -> Everything:
        fields = {n: getattr(everything, n) for n in everything.__struct_fields__}
        return Everything(**{**fields, "number": everything.number + 1})

    def fail(self, why: str) -> None:
        raise LookupError(why)

    def wait(self, seconds: float) -> None:
        threading.Event().wait(seconds)

    def back(self, depth: int) -> int:
        return 1 + self.backs.further(depth - 1) if depth else 0

    def note(self, text: str) -> None:
        self.heard.publish(Number(len(text)))

    @subscribed(block=4)
    def number(self, message: Number) -> None:
        self.heard.publish(Number(message.value + 1))

    @subscribed(block=4)
    def picture(self, message: Everything) -> None:
        self.heard.publish(Number(int(message.array.sum())))


class Source(Component):
    """What calls from Python; of C++ the test calls `asks`."""

    sums: Required[Sums]
    backs: Provided[Backs]
    number: Published[Number]
    picture: Published[Everything]

    def add(self, one: int, two: int) -> int:
        return self.sums.add(one, two=two)

    def echo(self, everything: Everything) -> Everything:
        return self.sums.echo(everything)

    def fail(self, why: str) -> list[str]:
        with pytest.raises(CalleeError) as caught:
            self.sums.fail(why)
        return [caught.value.type_name, caught.value.message]

    def wait(self, seconds: float) -> str:
        with pytest.raises(Timeout) as caught:
            self.sums.wait(seconds)
        return str(caught.value)

    def back(self, depth: int) -> int:
        return self.sums.back(depth)

    def further(self, depth: int) -> int:
        return 1 + self.sums.back(depth - 1) if depth else 0

    def note(self, text: str) -> None:
        self.sums.note(text)

    def publish(self, value: int) -> None:
        self.number.publish(Number(value))

    def show(self) -> None:
        array = np.full((200, 200), 0.5, np.float32)
        self.picture.publish(everything(array))


class Ear(Source):
    """Also hears what the target says."""

    heard: list[int]

    @subscribed("heard", block=4)
    def on_heard(self, message: Number) -> None:
        self.heard.append(message.value)


def everything(array: NDArray[np.float32]) -> Everything:
    return Everything(
        number=1,
        real=2.5,
        flag=True,
        text="é",
        points=[Point(1.0, 2.0)],
        maybe=None,
        named={"a": 1.0},
        two=(3.0, 4.0),
        raw=b"\0b",
        array=array,
        at=Stamp(5.0, "here"),
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Build the example and the components beside this file, in a fresh folder."""
    # of the test's own environment first
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    tools = {tool: shutil.which(tool, path=path) for tool in ("c++", "cmake")}
    missing = [tool for tool, place in tools.items() if not place]
    if missing:
        pytest.skip(f"components in C++ cannot be built: no {' and no '.join(missing)}")
    folder = tmp_path_factory.mktemp("cpp")
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    shutil.copy(Path(__file__).with_name("mixed.cpp"), folder)
    with (folder / "CMakeLists.txt").open("a") as file:
        file.write("poise_add_component(mixed SOURCES mixed.cpp)\n")
    options = {
        "poise_DIR": cmake.folder(),
        "Python_EXECUTABLE": sys.executable,
        "CMAKE_BUILD_TYPE": "Debug",
        "CMAKE_CXX_FLAGS_DEBUG": "-O0",
    }
    defined = [f"-D{name}={value}" for name, value in options.items()]
    for words in (["-S", ".", "-B", "build", *defined], ["--build", "build", "-j2"]):
        run = subprocess.run(
            [str(tools["cmake"]), *words],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=LONG,
            check=False,
        )
        assert run.returncode == 0, run.stdout + run.stderr
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def mixed(built: Path) -> ModuleType:
    del built
    return importlib.import_module("mixed")


@pytest.fixture(params=["cpp-cpp", "cpp-py", "py-cpp"])
def classes(request: pytest.FixtureRequest, mixed: ModuleType) -> tuple[Any, Any]:
    """Return a source and a target, of which one at least is in C++."""
    source, target = request.param.split("-")
    return (
        mixed.Source if source == "cpp" else Source,
        mixed.Target if target == "cpp" else Target,
    )


def start(pair: Pair, classes: tuple[Any, Any], limit: float = LIMIT) -> Any:
    """Join a source and a target in all ways; return the source."""
    source = pair.run("source", classes[0])
    pair.run("target", classes[1])
    for port in ("sums", "number", "picture"):
        pair.join(port, limit=limit)
    pair.join_back("backs", "backs")
    if "heard" in ports_of(classes[0]):
        pair.join_back("heard", "heard")
    pair.activate()
    return source


@every_kind
def test_calls_go_both_ways_between_languages(
    pair: Pair, classes: tuple[Any, Any]
) -> None:
    source = start(pair, classes)
    assert source.add(2, 3) == 5
    array = np.arange(30_000, dtype=np.float32).reshape(100, 300)
    # as a chain that the source's own code begins
    new_chain()
    answer = source.echo(everything(array))
    assert answer.number == 2
    assert (answer.text, answer.raw, answer.two) == ("é", b"\0b", (3.0, 4.0))
    assert (answer.points[0].y, answer.maybe, answer.named) == (2.0, None, {"a": 1.0})
    assert (answer.at.at, answer.at.computer) == (5.0, "here")
    assert (answer.array == array).all()


@every_kind
def test_an_error_of_the_callee_has_its_type_and_what_it_says(
    pair: Pair, classes: tuple[Any, Any]
) -> None:
    source = start(pair, classes)
    types = {Target: "LookupError"}
    expected = types.get(classes[1], "trouble::Empty")
    assert source.fail("no eggs") == [expected, "no eggs"]
    assert source.add(1, 1) == 2


@every_kind
def test_what_does_not_fit_the_types_in_cpp_cannot_cross(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (Source, mixed.Target))
    with pytest.raises(CannotCross, match=r"add.* an integer may be|<= 2147483647"):
        source.sums.add(2**40, 1)
    unfit = structs.replace(everything(np.zeros(4, np.float32)), text="\ud800")
    with pytest.raises(CannotCross, match=r"UTF-8|utf-8"):
        source.sums.echo(unfit)
    assert source.add(1, 1) == 2


@every_kind
def test_a_late_result_is_a_timeout(pair: Pair, classes: tuple[Any, Any]) -> None:
    source = start(pair, classes, limit=0.1)
    assert "limit 0.1 s" in source.wait(0.3)


@every_kind
def test_a_chain_of_calls_comes_back(pair: Pair, classes: tuple[Any, Any]) -> None:
    source = start(pair, classes)
    runner = pair.runners["source", 0]
    runner.exclusion.enter(new_chain(), LIMIT)
    try:
        assert source.back(4) == 4
    finally:
        runner.exclusion.leave()


@every_kind
def test_calls_are_started_and_their_answers_taken_later(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (mixed.Source, mixed.Target))
    runners = pair.runners["source", 0], pair.runners["target", 0]
    mine, theirs = (runner.exclusion for runner in runners)
    theirs.enter(new_chain(), LIMIT)
    try:
        assert source.start(0.05)
    finally:
        theirs.leave()

    def taken() -> list[str]:
        mine.enter(new_chain(), LIMIT)
        try:
            return sorted(source.taken())
        finally:
            mine.leave()

    wait_until(lambda: taken() == ["5", "cancelled", "no eggs"])


@every_kind
def test_a_limit_that_is_no_number_is_an_error_and_no_crash(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (mixed.Source, mixed.Target))
    with pytest.raises(UsageError, match=r"within\(nan\): give a number of seconds"):
        source.start(math.nan)


@every_kind
def test_messages_and_one_way_calls_reach_cpp(pair: Pair, mixed: ModuleType) -> None:
    heard: list[int] = []
    Ear.heard = heard
    source = start(pair, (Ear, mixed.Target))
    assert ports_of(mixed.Target)["heard"].latest
    source.publish(6)
    wait_until(lambda: heard == [7])
    source.note("four")
    wait_until(lambda: heard == [7, 4])
    source.show()  # 40000 times 0.5
    wait_until(lambda: heard == [7, 4, 20_000])


@every_kind
def test_cpp_publishes_to_python(pair: Pair, mixed: ModuleType) -> None:
    source = start(pair, (mixed.Source, Target))
    target = pair.runners["target", 0].component
    heard: list[Any] = []
    target.heard = Published(heard.append)  # type: ignore[attr-defined]
    source.publish(6)
    source.note("four")
    source.show()
    # there is no order among connectors
    wait_until(lambda: sorted(m.value for m in heard) == [4, 7, 20_000])


@pytest.mark.parametrize("pair", ["direct"], indirect=True)
def test_a_direct_call_between_components_in_cpp_needs_no_interpreter(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (mixed.Source, mixed.Target))
    sender = pair.runners["source", 0].endpoints.senders["source.sums-target.sums"]
    counted: list[int] = []
    asking = threading.Thread(target=lambda: counted.append(source.keep_adding(1.0)))
    asking.start()
    wait_until(lambda: sender.counts.calls > 0)
    before = sender.counts.calls
    ctypes.PyDLL(None).usleep(300_000)  # keeps the interpreter's lock
    # one that needs the lock would make none meanwhile, and a few afterwards
    assert sender.counts.calls - before > 20_000
    asking.join()
    assert counted == [sender.counts.calls]


@pytest.mark.parametrize("pair", ["direct"], indirect=True)
def test_an_array_reaches_cpp_and_comes_back_without_a_copy(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (Source, mixed.Target))
    array = np.zeros(100_000, np.float32)
    assert source.echo(everything(array)).array is array


@every_kind
def test_an_error_whose_text_cannot_be_sent_reaches_its_caller(
    pair: Pair, mixed: ModuleType, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise LookupError("no \udcff")

    source = pair.run("source", mixed.Mutterer)
    target = pair.run("target", mixed.Mutterer)
    target.fail = fail
    pair.join("others", "mutters")
    pair.activate()
    assert source.caught() == r"no \udcff"
    with pytest.raises(CalleeError, match=r"no \\xff") as caught:
        source.others.mutter()
    assert caught.value.type_name == "trouble::Empty"
    source.others.complain()
    assert r"low \xff" in caplog.text


@every_kind
def test_a_components_own_kind_of_timeout_keeps_its_name(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (Source, mixed.Target))
    assert source.fail("late") == ["trouble::Late", "late"]


def test_so_many_fields_may_be_listed_as_is_said(tmp_path: Path) -> None:
    most = 342
    header = Path(cmake.folder(), "include/poise/for_each.hpp")
    text = header.read_text()
    assert f"up to {most} names" in text
    names = ", ".join(f"field{number}" for number in range(most))
    file = tmp_path / "many.cpp"
    file.write_text(f"{text}\nPOISE_FOR_EACH(<>, {names})\n")
    argv = ["c++", "-std=c++20", "-E", "-P", str(file)]
    run = subprocess.run(argv, capture_output=True, text=True, check=True)
    assert run.stdout.count("<>(field") == most
    assert "POISE" not in run.stdout


ENDING = """
import gc, time, mixed
from poise.testing import Bench

with Bench(mixed.Busy):
    time.sleep(0.1)
gc.collect()
print("ended")
"""


@pytest.mark.usefixtures("mixed")
def test_a_component_may_join_its_thread_when_it_is_destroyed(built: Path) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", ENDING],
        cwd=built,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert (ended.stdout, ended.returncode) == ("ended\n", 0), ended.stderr


GOES_ON = """
import time, mixed
from poise.testing import Bench

class Slow:
    def __del__(self):
        time.sleep(0.3)

slow = Slow()
bench = Bench(mixed.Endless)
bench.__enter__()
time.sleep(0.1)
"""


@pytest.mark.usefixtures("mixed")
def test_a_thread_that_goes_on_while_the_interpreter_ends_does_not_abort_it(
    built: Path,
) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", GOES_ON],
        cwd=built,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_handlers_of_one_container_run_at_the_same_time(mixed: ModuleType) -> None:
    with Bench(mixed.Meeting) as one, Bench(mixed.Meeting) as other:
        threads = [
            threading.Thread(target=bench.advance, args=(0.03,))
            for bench in (one, other)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert one.measured["met"] == other.measured["met"] == [1.0]


def test_types_are_compared_with_pythons_by_their_fields(mixed: ModuleType) -> None:
    for mine, theirs in ((Sums, mixed.Sums), (Everything, mixed.Everything)):
        assert fingerprint(mine) == fingerprint(theirs)


@every_kind
def test_an_argument_of_another_type_is_refused(pair: Pair, mixed: ModuleType) -> None:
    start(pair, (Source, mixed.Target))
    source = pair.runners["source", 0].component
    with pytest.raises((CalleeError, CannotCross), match="str"):
        source.sums.add("1", 2)  # type: ignore[attr-defined]


@pytest.mark.parametrize("pair", ["local"], indirect=True)
def test_a_number_that_its_type_in_cpp_cannot_hold_is_refused(
    pair: Pair, mixed: ModuleType
) -> None:
    source = start(pair, (Source, mixed.Target))
    with pytest.raises(CannotCross, match=r"Expected `int` <= 2147483647"):
        source.add(2**31, 0)
    assert source.add(2**31 - 1, 0) == 2**31 - 1


def test_a_module_that_was_built_with_other_headers_is_refused(
    built: Path, tmp_path: Path
) -> None:
    python = make_release(tmp_path, "0.0.9", PROTOCOL)
    (header,) = tmp_path.rglob("poise/cpp/include/poise/ports.hpp")
    header.write_text(f"{header.read_text()}// changed\n")
    run = subprocess.run(
        [str(python), "-m", "poise", "check", "robot.yaml"],
        cwd=built,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    said = " ".join((run.stdout + run.stderr).split())
    assert run.returncode != 0
    here = f"built for Poise {cmake.release()}, but this is Poise 0.0.9, headers"
    assert here in said


def test_a_bench_runs_the_examples_controller(built: Path) -> None:
    del built
    pilot = importlib.import_module("pilot")

    class Recorder:
        def heat(self, power: float) -> float:
            return power * 2000

    with Bench(pilot.Controller, {"gain": 0.05}, heating=Recorder()) as bench:
        for celsius in (170.0, 180.0):
            bench.send("reading", pilot.Reading(celsius, Stamp(0.0)))
    assert bench.measured["watts"] == [1000.0, 0.0]
    assert bench.component.snapshot() == pilot.Learned(gain=0.05, readings=2)


MOVES = (
    ("passer", "right"),
    ("source", "right"),
    ("passer", "left"),
    ("source", "left"),
)
COUNTED = """
robot: counted-cpp-{number}
computers:
  left: {{cpu: 0.8, memory: 1 GiB}}
  right: {{cpu: 0.8, memory: 1 GiB}}
links:
  - {{between: [left, right], bandwidth: 100 Mbit/s}}
architectures:
  counted:
    function: counting
    home: left
    components:
      source: {{implementation: "mixed:CountingSource", cpu: 10%, memory: 30 MiB}}
      passer: {{implementation: "mixed:CountingPasser", cpu: 10%, memory: 30 MiB}}
      sink: {{implementation: "counted:Sink", cpu: 10%, memory: 30 MiB}}
    connectors:
      - {{between: [source.numbers, passer.numbers], rate: 200 Hz, limit: 5 s}}
      - {{between: [passer.passed, sink.passed], rate: 200 Hz, limit: 5 s}}
      - {{between: [source.doubles, passer.doubles], rate: 20 Hz, limit: 5 s}}
tasks:
  count: {{actions: [{{name: count, functions: [counting]}}]}}
"""


def test_moves_lose_no_message_no_call_and_no_state(built: Path) -> None:
    shutil.copy(ROOT / "examples/counted/counted.py", built)
    (built / "counted.yaml").write_text(COUNTED.format(number=os.getpid()))
    robot = poise.load(built / "counted.yaml")
    placement = place(robot, method="static")
    with (
        poise.emulated(robot, say=print),
        poise.up(robot, placement=placement, say=print) as up,
    ):

        def received(more: int) -> None:
            goal = measures(up).get("received", 0) + more
            wait_long(lambda: measures(up).get("received", 0) >= goal)

        def sent() -> int:
            wait_long(lambda: "sent" in measures(up))  # a moved one tells it soon
            return int(measures(up)["sent"])

        received(more=100)
        for component, computer in MOVES:
            before = sent()
            up.move(component, computer)
            received(more=100)
            # with a fresh state it would count from 1 again
            assert sent() > before
        counts = measures(up)
    assert (counts["lost"], counts["doubled"], counts["reordered"]) == (0, 0, 0)
    assert counts["failed"] == 0
    # one of ten numbers is doubled; the last ones may not be measured yet
    assert counts["answered"] >= counts["sent"] // 10 - 10


def test_the_check_compares_types_and_parameters_with_cpp(built: Path) -> None:
    robot = built / "wrong.yaml"
    wrong = (
        ("pilot:Heater", "mixed:Target"),
        ("heater.heating", "heater.sums"),
        ("{gain: 5%}", "{gian: 5%}"),
        (
            "thermometer.reading, controller.reading",
            "thermometer.reading, heater.number",
        ),
    )
    text = (built / "robot.yaml").read_text()
    for old, new in wrong:
        assert old in text
        text = text.replace(old, new)
    robot.write_text(text)
    said = called(["check", str(robot)])
    assert said.returncode == 1
    problems = said.stdout + said.stderr
    assert "there is no parameter 'gian' (did you mean 'gain'?)" in problems
    assert "Heating" in problems
    assert "Sums" in problems
    assert "Reading" in problems
    assert "Number" in problems


def test_parameters_are_set_while_it_runs_or_refused(built: Path) -> None:
    del built
    pilot = importlib.import_module("pilot")
    with Bench(pilot.Controller, {"gain": "5 %"}, heating=None) as bench:
        controller = bench.component
        assert controller.parameters == pilot.Gains(gain=0.05, target=180.0)
        set_parameters(controller, {"gain": 0.5})
        assert controller.snapshot().gain == 0.5
        with pytest.raises(
            Exception, match="such a gain would make it swing"
        ) as caught:
            set_parameters(controller, {"gain": 5.0})
        assert type(caught.value).__qualname__ == "std::invalid_argument"
        assert controller.parameters.gain == 0.5
