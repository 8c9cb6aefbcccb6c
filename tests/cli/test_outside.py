"""Calls and messages from outside a running robot, while its components move."""

from __future__ import annotations

import itertools
import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import poise as api
from poise.cli import outside_command
from poise.emulate import probe_host
from poise.errors import CalleeError, CannotCross, RunError, Timeout, UsageError
from tests.command import Poise, robot_up, run_poise
from tests.view.test_robot_recording import read
from tests.waiting import wait_long

pytestmark = pytest.mark.slow

NAME = f"outside{os.getpid()}"
CODE = """
import time
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from poise import Component, Message, Provided, Published, Required, oneway, subscribed


class Number(Message):
    value: int


class Picture(Message):
    pixels: NDArray[np.uint8]


class Sums(Protocol):
    def add(self, value: int) -> int: ...

    def total(self) -> int: ...

    def size(self, picture: Picture) -> NDArray[np.int64]: ...

    def sleep(self, seconds: float) -> None: ...

    def grow(self, size: int) -> bytes: ...

    @oneway
    def note(self, value: int) -> None: ...


class Gains(Message):
    gain: float
    period: float = 0.5


class Summer(Component):
    parameters: Gains
    sums: Provided[Sums]
    said: Published[Number]
    lone: Published[Number]

    def configure(self) -> None:
        self.sum = 0

    def add(self, value: int) -> int:
        if value < 0:
            raise ValueError(f"{value} is negative")
        self.sum += value
        return self.sum

    def total(self) -> int:
        return self.sum

    def size(self, picture: Picture) -> NDArray[np.int64]:
        return np.array(picture.pixels.shape)

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def grow(self, size: int) -> bytes:
        self.sum += 1
        return bytes(size) if size else object()

    def note(self, value: int) -> None:
        self.sum += value

    @subscribed(block=10)
    def numbers(self, message: Number) -> None:
        self.sum += message.value

    def reconfigure(self, parameters: Gains) -> None:
        if parameters.gain > 1:
            raise ValueError(f"a gain of {parameters.gain} is too much")

    def snapshot(self) -> int:
        return self.sum

    def restore(self, state: int) -> None:
        self.sum = state


class Asks(Protocol):
    def ask(self, seconds: float) -> None: ...

    def answers(self) -> int: ...


class Asker(Component):
    asks: Provided[Asks]
    first: Required[Sums]
    second: Required[Sums]

    def configure(self) -> None:
        self.taken = 0

    def ask(self, seconds: float) -> None:
        for sums in self.first, self.second:
            self.start_call(sums.sleep, seconds).then(self.take)

    def take(self, call: object) -> None:
        call.result()
        self.taken += 1

    def answers(self) -> int:
        return self.taken

    def snapshot(self) -> int:
        return self.taken

    def restore(self, state: int) -> None:
        self.taken = state


class Silent(Component):
    numbers: Published[Number]

    @subscribed(keep=1)
    def pictures(self, message: Picture) -> None: ...

    def configure(self) -> None:
        self.limit = self.parameters["limit"]


class Hearer(Summer):
    said: Published[Picture]

    @subscribed(keep=1000)
    def heard(self, message: Number) -> None:
        self.sum += message.value
"""
ROBOT = f"""
robot: {NAME}
computers:
  left: {{cpu: 1, memory: 1 GiB}}
  right: {{cpu: 1, memory: 1 GiB}}
architectures:
  adding:
    function: adding
    home: left
    components:
      summer:
        implementation: "{NAME}:Summer"
        parameters: {{gain: 50%}}
        cpu: 5%
        memory: 50 MiB
      hearer:
        implementation: "{NAME}:Hearer"
        parameters: {{gain: 1}}
        cpu: 5%
        memory: 50 MiB
      silent:
        implementation: "{NAME}:Silent"
        parameters: {{limit: 3}}
        cpu: 5%
        memory: 50 MiB
      asker: {{implementation: "{NAME}:Asker", cpu: 5%, memory: 50 MiB}}
    connectors:
      - {{between: [asker.first, summer.sums], limit: 10 s}}
      - {{between: [asker.second, hearer.sums], limit: 10 s}}
      - {{between: [summer.said, hearer.heard]}}
      - {{between: [hearer.said, silent.pictures]}}
      - {{between: [silent.numbers, summer.numbers]}}
      - {{between: [silent.numbers, hearer.numbers]}}
tasks:
  add: {{actions: [{{name: add, functions: [adding]}}]}}
"""


@pytest.fixture(scope="module", autouse=True)
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[api.Running]:
    """Keep a robot up for all tests of this file."""
    folder = tmp_path_factory.mktemp("outside")
    (folder / f"{NAME}.py").write_text(CODE)
    (folder / "robot.yaml").write_text(ROBOT)
    sys.path.append(str(folder))
    with robot_up(folder / "robot.yaml"):
        yield api.connect(NAME)
    sys.path.remove(str(folder))


def total(robot: api.Running, component: str = "summer") -> int:
    result = robot.component(component).call("sums", "total", limit=20.0)
    assert isinstance(result, int)
    return result


def move(robot: api.Running, component: str) -> None:
    here = robot.status().placement[component]
    robot.move(component, "left" if here == "right" else "right", force=True)


def test_calls_made_while_a_component_moves_are_made_once(robot: api.Running) -> None:
    before, ended, made = total(robot), threading.Event(), [0, 0]
    failures: list[Exception] = []

    def call(number: int) -> None:
        try:
            while not ended.is_set():
                robot.component("summer").call("sums", "add", 1, limit=20.0)
                made[number] += 1
        except Exception as error:
            failures.append(error)
            raise

    callers = [threading.Thread(target=call, args=(number,)) for number in range(2)]
    for caller in callers:
        caller.start()
    for _ in range(4):
        move(robot, "summer")
    ended.set()
    for caller in callers:
        caller.join()
    assert failures == []
    assert min(made) > 0
    assert total(robot) - before == sum(made)


@pytest.mark.parametrize(
    ("port", "hearer"), [("numbers", "summer"), ("said", "hearer")]
)
def test_messages_sent_while_a_component_moves_come_once(
    robot: api.Running, port: str, hearer: str
) -> None:
    before, ended = total(robot, hearer), threading.Event()

    def go_on_moving() -> None:
        while not ended.is_set():
            move(robot, "summer")

    mover = threading.Thread(target=go_on_moving)
    mover.start()
    try:
        for _ in range(200):
            robot.component("summer").publish(port, {"value": 1}, limit=20.0)
    finally:
        ended.set()
        mover.join()
    wait_long(lambda: total(robot, hearer) - before >= 200)
    assert total(robot, hearer) - before == 200


def test_a_move_waits_for_the_answers_of_calls_that_were_started(
    robot: api.Running,
) -> None:
    asker = robot.component("asker")
    for asked in range(2, 10, 2):
        asker.call("asks", "ask", 0.3, limit=20.0)
        move(robot, "asker")
        assert asker.call("asks", "answers", limit=20.0) == asked


def test_an_interface_has_the_types_that_it_declares(robot: api.Running) -> None:
    code: Any = __import__(NAME)
    sums = robot.component("summer").interface("sums", code.Sums, limit=10.0)
    before = sums.total()
    assert sums.note(3) is None
    assert sums.add(4) in {before + 4, before + 7}
    size = sums.size(code.Picture(np.zeros((3, 5), np.uint8)))
    assert size.tolist() == [3, 5]


def test_hears_whole_messages_of_a_topic(robot: api.Running) -> None:
    code: Any = __import__(NAME)
    heard: list[int] = []

    def hear() -> None:
        numbers = robot.component("summer").subscribe("said", code.Number)
        heard.extend(each.value for each in itertools.islice(numbers, 3))

    hearer = threading.Thread(target=hear, daemon=True)
    hearer.start()
    for value in itertools.count(1):
        robot.component("summer").publish("said", code.Number(value), limit=10.0)
        if not hearer.is_alive() or value == 1000:
            break
    hearer.join(10.0)
    assert len(heard) == 3
    assert heard == list(range(heard[0], heard[0] + 3))


def test_pictures_are_recorded_whole(robot: api.Running, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="mcap is not installed")
    path, ended = tmp_path / "run.mcap", threading.Event()
    pixels = np.arange(40 * 30 * 3).reshape(40, 30, 3).astype(np.uint8)

    def publish() -> None:
        while not ended.wait(0.02):
            hearer = robot.component("hearer")
            hearer.publish("said", {"pixels": pixels}, limit=10.0)

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        recorded = api.record(path, ["hearer.said"], robot=NAME, seconds=2.0)
    finally:
        ended.set()
        publisher.join()
    found = {topic: (schema, value) for topic, schema, _, value in read(path)}
    of_picture, picture = found["/pictures/hearer/said-silent/pictures/pixels"]
    assert (of_picture, picture["encoding"]) == ("foxglove.RawImage", "rgb8")
    assert picture["data"] == pixels.tobytes()
    _, message = found["/messages/hearer/said-silent/pictures"]
    assert message["pixels"]["shape"] == [40, 30, 3]
    assert not recorded.left_out
    heard: list[Any] = []

    def hear() -> None:
        messages = robot.component("hearer").subscribe("said", dict)
        heard.extend(each["pixels"] for each in itertools.islice(messages, 5))

    hearing = threading.Thread(target=hear, daemon=True)
    hearing.start()
    while hearing.is_alive():
        played = api.play(path, robot=NAME, rate=4.0)
        written = recorded.messages["/messages/hearer/said-silent/pictures"]
        assert played.messages["hearer.said"] == written
    assert len(heard) == 5
    assert all(np.array_equal(each, pixels) for each in heard)


def test_a_component_that_is_not_there_is_named_at_once(robot: api.Running) -> None:
    with pytest.raises(UsageError, match=r"'sumer' \(did you mean 'summer'\?\)"):
        robot.component("sumer")


def test_a_port_without_a_connector_is_shown(robot: api.Running) -> None:
    readings = robot.echo("summer.lone", rate=1e6)
    assert not next(readings).passed
    robot.component("summer").publish("lone", {"value": 7}, limit=10)
    passed = itertools.chain.from_iterable(reading.passed for reading in readings)
    assert next(passed).value == {"value": 7}
    with pytest.raises(UsageError, match=r"publishes no 'loan' \(did you mean 'lone'"):
        next(robot.echo("summer.loan"))


def test_the_command_prints_what_a_call_returned(poise: Poise) -> None:
    wide = ("--robot", NAME, "--limit", 10)
    text = poise("call", "summer.sums", "size", "{pixels: [[1, 2, 3]]}", *wide).stdout
    assert text == "- 1\n- 3\n"
    done = poise("call", "summer.sums", "add", "value=0", "--json", *wide)
    assert isinstance(json.loads(done.stdout)["result"], int)
    assert poise("call", "summer.sums", "note", 1, *wide).stdout == ""
    sent = poise("pub", "summer.numbers", "{value: 1}", "--count", 3, *wide)
    assert sent.stderr == "sent 3 messages to summer.numbers\n"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("call summer.sums add -- -1", 1, "ValueError: -1 is negative"),
        (
            "call summer.sums add x",
            2,
            "argument 1 of add is not of type int: Expected `int`",
        ),
        ("call summer.sums add", 2, "add: missing a required argument: 'value'"),
        ("call summer.sums ad 1", 2, "no method 'ad' (did you mean 'add'?)"),
        ("call summer.sum add 1", 2, "no port 'sum' (did you mean 'sums'?)"),
        ("call sumer.sums add 1", 2, "no component 'sumer' (did you mean 'summer'?)"),
        ("call summer.said add 1", 2, "'summer.said' does not answer calls"),
        ("call summer add 1", 2, "'summer': give COMPONENT.PORT"),
        ("call summer.sums sleep 5 --limit 0.2", 1, "summer.sums"),
        ("call summer.sums total --limit 99", 2, "at most 50 s"),
        ("pub summer.numbers {value:", 2, "neither JSON nor YAML"),
        (
            "pub summer.numbers 3",
            2,
            "the message is not of type Number: Expected `object`",
        ),
        ('pub summer.numbers {"value":1,"vale":2}', 2, "Number has no 'vale' (did you"),
        ("pub summer.sums 3", 2, "'summer.sums' does not take or publish messages"),
    ],
)
def test_what_does_not_fit_is_refused_with_a_reason(
    poise: Poise, words: str, code: int, said: str
) -> None:
    before = words.split(" --limit", maxsplit=1)[0]
    verb, port, *rest = before.split(" ", 2 if before.startswith("pub") else -1)
    more = [words[len(before) :].rsplit(maxsplit=1)[-1]] if words != before else []
    limit = ["--limit", *more] if more else []
    done = poise(verb, port, "--robot", NAME, *limit, *rest)
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    assert "sent 1" not in done.stderr


def test_errors_are_those_of_calls_between_components(robot: api.Running) -> None:
    summer = robot.component("summer")
    with pytest.raises(CalleeError) as raised:
        summer.call("sums", "add", -1, limit=10.0)
    assert (raised.value.type_name, raised.value.message) == (
        "ValueError",
        "-1 is negative",
    )
    assert "in add" in raised.value.traceback
    with pytest.raises(Timeout):
        summer.call("sums", "sleep", 1.0, limit=0.1)
    with pytest.raises(UsageError, match="returned no dict: Expected"):
        summer.call("sums", "total", returns=dict)


@pytest.mark.parametrize(
    ("size", "why"), [(17_000_000, r"has 170000\d\d B, over 16777216 B"), (0, "object")]
)
def test_a_call_whose_result_cannot_leave_was_made(
    robot: api.Running, poise: Poise, size: int, why: str
) -> None:
    summer = robot.component("summer")
    before = summer.call("sums", "total", limit=10.0)
    with pytest.raises(CannotCross, match=f"it was called, but its result .*{why}"):
        summer.call("sums", "grow", size, limit=10.0)
    assert summer.call("sums", "total", limit=10.0) == before + 1
    done = poise("call", "summer.sums", "grow", str(size), "--robot", NAME)
    assert done.returncode == 1, done.stderr


def test_parameters_are_kept_through_moves_and_restarts(
    robot: api.Running, poise: Poise
) -> None:
    summer = robot.component("summer")
    assert summer.parameters(limit=20.0) == {"gain": 0.5, "period": 0.5}
    done = poise(
        "param",
        "set",
        "summer",
        "gain=25%",
        "period=20 ms",
        "--robot",
        NAME,
        "--json",
        "--limit",
        20,
    )
    assert json.loads(done.stdout) == {"gain": 0.25, "period": 0.02}
    kept = {"gain": 0.25, "period": 0.02}
    move(robot, "summer")
    assert summer.parameters(limit=20.0) == kept
    said = poise("status", "--robot", NAME).stdout
    assert "parameters of 'summer' that were set since the start" in said
    (pid,) = {
        container.pid
        for status in robot.status().computers.values()
        for container in status.containers
        for component in container.components
        if component.name == "summer"
    }
    os.kill(pid, signal.SIGKILL)
    wait_long(lambda: pid not in pids(robot))
    assert summer.parameters(limit=20.0) == kept
    shown = poise("param", "get", "summer", "gain", "--robot", NAME)
    assert shown.stdout == "0.25\n"


def test_the_next_manager_keeps_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if reasons := probe_host().without_network():
        pytest.skip("; ".join(reasons))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    next_ = f"{NAME}-next"
    (tmp_path / f"{NAME}.py").write_text(CODE)
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.replace(f"robot: {NAME}", f"robot: {next_}"))
    try:
        assert run_poise("up", file, "--detach").returncode == 0
        first = api.connect(next_)
        first.component("summer").set_parameters({"gain": 0.75}, limit=20.0)
        os.kill(first.status().manager.pid, signal.SIGKILL)
        assert run_poise("up", file, "--detach").returncode == 0
        robot = api.connect(next_)
        for _ in range(2):
            values = robot.component("summer").parameters(limit=20.0)
            assert values == {"gain": 0.75, "period": 0.5}
            move(robot, "summer")
    finally:
        run_poise("stop", "--robot", next_)
        run_poise("emulate", "stop", "--robot", next_)


def test_parameters_that_do_not_fit_change_nothing(poise: Poise) -> None:
    for changes, code, said in (
        (("gain=2",), 2, "'hearer' refused 'gain': ValueError: a gain of 2.0 is"),
        (("gain=0.1", "perod=1"), 2, "no parameter 'perod' (did you mean 'period'?)"),
        (("gain=high",), 2, "parameter 'gain' is 'high': Expected `float`"),
        (("gain",), 2, "'gain': give NAME=VALUE"),
    ):
        done = poise("param", "set", "hearer", *changes, "--robot", NAME, "--limit", 20)
        assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    done = poise("param", "set", "silent", "limit=4", "--robot", NAME)
    assert (done.returncode, "has no `reconfigure`" in done.stderr) == (2, True)
    done = poise("param", "list", "--robot", NAME, "--json")
    assert json.loads(done.stdout)["hearer"] == {"gain": 1.0, "period": 0.5}
    assert json.loads(done.stdout)["silent"] == {"limit": 3}


def test_the_check_says_where_a_parameter_does_not_fit(
    poise: Poise, tmp_path: Path
) -> None:
    (tmp_path / f"{NAME}.py").write_text(CODE)
    (tmp_path / "robot.yaml").write_text(ROBOT.replace("gain: 50%", "gian: 50%"))
    done = poise("check", tmp_path / "robot.yaml")
    assert done.returncode == 1
    assert "robot.yaml:13:" in done.stdout + done.stderr
    assert "no parameter 'gian' (did you mean 'gain'?)" in done.stdout + done.stderr
    assert "parameter 'gain' is missing" in done.stdout + done.stderr


def test_calls_wait_for_a_container_that_was_killed(robot: api.Running) -> None:
    """Of those that were under way nobody knows; the others are made."""
    ended, unknown = threading.Event(), list[str]()

    def call() -> None:
        while not ended.is_set():
            try:
                robot.component("summer").call("sums", "total", limit=20.0)
            except RunError as error:
                unknown.append(str(error))

    caller = threading.Thread(target=call)
    caller.start()
    try:
        for _ in range(3):
            wait_long(lambda: pids(robot))  # the one before is started again
            killed = min(pids(robot))
            os.kill(killed, signal.SIGKILL)
            wait_long(lambda pid=killed: pid not in pids(robot))  # type: ignore[misc]
    finally:
        ended.set()
        caller.join()
    assert all("may have been taken" in why for why in unknown), unknown
    assert not any("does not run" in why for why in unknown), unknown


def pids(robot: api.Running) -> set[int]:
    return {
        container.pid
        for status in robot.status().computers.values()
        for container in status.containers
        if container.components
    }


def test_one_who_does_not_run_is_waited_for_within_the_limit(
    robot: api.Running,
) -> None:
    robot.tasks.cancel("add")
    why = r"within 0\.2 s: .*no task at work needs it, or its architecture is suspended"
    with pytest.raises(RunError, match=why):
        robot.component("summer").call("sums", "total", limit=0.2)
    robot.tasks.start("add")
    assert total(robot) >= 0


def test_ctrl_c_ends_a_series_of_messages_and_says_how_many_there_were(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Publisher:
        tried = 0

        def publish(self, *_: object, **__: object) -> None:
            self.tried += 1
            if self.tried == 2:
                raise RunError("its container has ended")
            if self.tried == 3:
                os.kill(os.getpid(), signal.SIGINT)

    publisher = Publisher(), "count"
    monkeypatch.setattr(outside_command, "_component", lambda *_: publisher)
    with pytest.raises(SystemExit) as ended:
        outside_command.pub_command("counter.count", "{value: 7}", rate=1000.0)
    assert ended.value.code == 130
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "sent 2 messages to counter.count",
        "1 message may be lost; the last: its container has ended",
    ]
