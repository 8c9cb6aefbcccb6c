"""A robot file is held against the classes that it names."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem
from poise.model.loading import load_source
from poise.model.robot import ComponentEntry
from poise.runtime.code_check import check_code, code_of

CODE = """
from poise import (
    Component, Message, Provided, Published, Required, every, lost, oneway, subscribed
)

class Scan(Message, frozen=True):
    ranges: list[float]

class Pose(Message, frozen=True):
    x: float

class Poses:
    def pose(self, at: float) -> Pose: ...

class Torn(Message, frozen=True):
    rest: "Lost"

class Walls:
    def walls(self) -> int: ...

class Scanner(Component):
    scan: Published[Scan]

class Localiser(Component):
    poses: Provided[Poses]

    @subscribed(keep=1)
    def scan(self, message: Scan) -> None: ...

    def pose(self, at: float) -> Pose: ...

class Posing(Component):
    poses: Provided[Poses]

    def pose(self, at: float) -> Pose: ...

class Hinted(Component):
    @subscribed(keep=1)
    def hints(self, message: Pose) -> None: ...

class Tuned(Component):
    def configure(self) -> None:
        self.gain = self.parameters["gain"]
        self.rate = self.parameters.get("rate", 1.0) if "bias" in self.parameters else 0

class Converting(Tuned):
    def activate(self) -> None:
        self.others = dict(**self.parameters)

class Navigator(Component):
    poses: Required[Poses]

class Mapper(Component):
    walls: Provided[Walls]

    def walls(self) -> int: ...

class Lacking(Component):
    poses: Provided[Poses]

class Untyped(Component):
    @subscribed(keep=1)
    def scan(self, message): ...

class Asks:
    def ask(self) -> int: ...

class Tells:
    @oneway
    def tell(self) -> None: ...

class Round(Component):
    out: Required[Asks]
    into: Provided[Asks]

    def ask(self) -> int: ...

class Letting(Round):
    reentrant = True

class Telling(Component):
    out: Required[Tells]
    into: Provided[Asks]

    def ask(self) -> int: ...

class Told(Component):
    out: Required[Asks]
    into: Provided[Tells]

    def tell(self) -> None: ...

class Filling(Component):
    out: Published[Pose]

    @subscribed(block=2)
    def into(self, message: Pose) -> None: ...

class LettingFill(Filling):
    reentrant = True

class Passing(Component):
    out: Published[Pose]

    @subscribed(keep=2)
    def into(self, message: Pose) -> None: ...

class Loose:
    def turn(self, angle) -> None: ...

class Turning(Component):
    loose: Provided[Loose]

    def turn(self, angle: float) -> None: ...

class Vague(Component):
    either: Published[Scan | Pose]

class Forgetting(Component):
    def restore(self, state): ...

class Undecided(Component):
    def restore(self, state: Scan | Pose): ...

class Walking(Component):
    done: Published[bool]
    at: Published[Pose]

class Ticking(Component):
    @every(1.0)
    def tick(self): ...

class Thrice(Untyped):
    scans: Published

    @lost("scan")
    @every(1.0)
    def tick(self, now): ...

class Misspelt(Component):
    scan: Published["Sacn"]
"""

ROBOT = """
robot: r
computers: {main: {cpu: 1, memory: 1 GiB}}
architectures:
  nav:
    function: f
    components:
      scanner: {implementation: "PACKAGE.nav:Scanner"}
      localiser: {implementation: "PACKAGE.nav:Localiser"}
      MORE
    connectors:
      - {between: [scanner.scan, localiser.scan]}
      CONNECTOR
"""

Check = Callable[[str, str], list[FileProblem]]
Refuse = Callable[..., None]


@pytest.fixture
def check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Check:
    """Return a function that gives the problems of a robot with these lines."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    package = "p" + str(abs(hash(str(tmp_path))))
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").touch()
    (tmp_path / package / "nav.py").write_text(CODE)

    def find_problems(more: str, connector: str) -> list[FileProblem]:
        path = tmp_path / "robot.yaml"
        text = ROBOT.replace("MORE", more).replace("CONNECTOR", connector)
        path.write_text(text.replace("PACKAGE", package))
        source = load_source(path)
        return [source.positions.problem(f) for f in check_code(source.robot)]

    return find_problems


def test_accepts_what_fits(check: Check) -> None:
    more = '{navigator: {implementation: "PACKAGE.nav:Navigator"}}'
    more = more[1:-1]
    assert check(more, "- {between: [navigator.poses, localiser.poses]}") == []


def test_accepts_a_subscription_that_gets_generated_messages(check: Check) -> None:
    workload = "\nworkload: {generate: {hinted.hints: {rate: 1 Hz}}}"
    more = 'hinted: {implementation: "PACKAGE.nav:Hinted"}'
    assert check(more, workload) == []


@pytest.mark.parametrize("code", ["Tuned", "Converting"])
def test_accepts_parameters_that_may_be_read(check: Check, code: str) -> None:
    """What converts all of its parameters may read any, so nothing is said of it."""
    more = "" if code == "Tuned" else ", any: 1"
    entry = f'"PACKAGE.nav:{code}", parameters: {{gain: 1, rate: 2, bias: 3{more}}}'
    assert check(f"tuned: {{implementation: {entry}}}", "") == []


@pytest.mark.parametrize(("where", "count"), [("", 1), (", address: 'b:7000'", 0)])
def test_looks_for_commands_of_emulated_computers(
    tmp_path: Path, where: str, count: int
) -> None:
    """Another computer may have programs that this one lacks."""
    file = tmp_path / "robot.yaml"
    file.write_text(
        f"robot: r\ncomputers: {{a: {{cpu: 1, memory: 1 GiB{where}}}}}\n"
        "architectures: {x: {function: f, components: {c: {command: nosuchprogram}}}}",
        encoding="utf-8",
    )
    assert len(check_code(load_source(file).robot)) == count


def test_refuses_a_module_that_another_of_its_name_hides(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each folder of the repository has a `hidden_twin.py`; the first one would run."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for number in (1, 2):
        folder = tmp_path / f"part{number}"
        folder.mkdir()
        code = f"import poise\nclass A(poise.Component):\n    number = {number}\n"
        (folder / "hidden_twin.py").write_text(code, encoding="utf-8")
        (folder / "a.yaml").write_text(
            f"architectures: {{a{number}: {{function: f{number}, components: "
            f'{{c{number}: {{implementation: "hidden_twin:A"}}}}}}}}',
            encoding="utf-8",
        )
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: r\nrepository: [part1, part2]\n"
        "computers: {a: {cpu: 1, memory: 1 GiB}}\n"
        "tasks: {t: {actions: [{name: w, functions: [f1, f2]}]}}\n",
        encoding="utf-8",
    )
    (finding,) = check_code(load_source(file).robot)
    assert finding.path[-2:] == ("c2", "implementation")
    assert "part1/hidden_twin.py, so " in finding.message
    assert "part2/hidden_twin.py would never run" in finding.message


def test_accepts_a_command_whose_port_fits(check: Check) -> None:
    more = 'log: {command: cat, ports: {in: {subscribes: "PACKAGE.nav:Scan"}}}'
    assert check(more, "- {between: [scanner.scan, log.in]}") == []


def test_does_not_look_at_the_ports_of_what_has_no_code(check: Check) -> None:
    more = "planned: {cpu: 5%}"
    assert check(more, "- {between: [scanner.scan, planned]}") == []


@pytest.mark.parametrize(
    ("more", "connector", "place", "words"),
    [
        (
            "",
            "- {between: [scanner.scam, localiser.scan]}",
            (13, 20),
            ["'scanner' has no port 'scam'", "did you mean 'scan'?", "publishes Scan"],
        ),
        (
            "",
            "- {between: [localiser.scan, scanner.scan]}",
            (13, 10),
            ["wrong way round", "[scanner.scan, localiser.scan]"],
        ),
        (
            'hinted: {implementation: "PACKAGE.nav:Hinted"}',
            "- {between: [scanner.scan, hinted.hints]}",
            (13, 10),
            ["types differ", "publishes Scan", "subscribes Pose"],
        ),
        (
            "",
            "- {between: [scanner.scan, localiser.poses]}",
            (13, 10),
            ["publishes and 'localiser.poses' provides", "does not fit"],
        ),
        (
            "",
            "- {between: [scanner, localiser.scan]}",
            (13, 20),
            ["name the port of component 'scanner'"],
        ),
        (
            'navigator: {implementation: "PACKAGE.nav:Navigator"}',
            "",
            (10, 7),
            ["'navigator.poses' requires Poses", "no connector"],
        ),
        (
            'hinted: {implementation: "PACKAGE.nav:Hinted"}',
            "",
            (10, 7),
            ["'hinted.hints' subscribes Pose", "no connector joins it to a publisher"],
        ),
        (
            'tuned: {parameters: {gian: 3}, implementation: "PACKAGE.nav:Tuned"}',
            "",
            (10, 28),
            ["no parameter 'gian'", "did you mean 'gain'", "'bias', 'gain', 'rate'"],
        ),
        (
            "driver: {command: [nosuchprogram, --fast]}",
            "",
            (10, 16),
            ["component 'driver': 'nosuchprogram': there is no such program"],
        ),
        (
            "driver: {ros2: {executable: ./nosuchnode.py}}",
            "",
            (10, 16),
            ["component 'driver': 'python': there is no such script as /"],
        ),
        (
            'lacking: {implementation: "PACKAGE.nav:Lacking"}',
            "",
            (10, 17),
            ["Lacking provides poses", "has no method pose"],
        ),
        (
            'untyped: {implementation: "PACKAGE.nav:Untyped"}',
            "",
            (10, 17),
            ["Untyped.scan", "takes one message"],
        ),
        (
            'turning: {implementation: "PACKAGE.nav:Turning"}',
            "",
            (10, 17),
            ["Loose.turn", "parameter 'angle' needs a type"],
        ),
        (
            'vague: {implementation: "PACKAGE.nav:Vague"}',
            "",
            (10, 15),
            ["cannot be read", "multiple Struct types"],
        ),
        (
            'forgetting: {implementation: "PACKAGE.nav:Forgetting"}',
            "",
            (10, 20),
            ["Forgetting.restore", "must say the state's type"],
        ),
        (
            'undecided: {implementation: "PACKAGE.nav:Undecided"}',
            "",
            (10, 19),
            ["Undecided.restore: ", "multiple Struct types"],
        ),
        (
            'misspelt: {implementation: "PACKAGE.nav:Misspelt"}',
            "",
            (10, 18),
            ["cannot be read", "NameError", "Sacn"],
        ),
        (
            'other: {implementation: "PACKAGE.nav:Othr"}',
            "",
            (10, 15),
            ["has no class 'Othr'"],
        ),
        (
            'log: {command: cat, ports: {in: {subscribes: "PACKAGE.nav:Sca"}}}',
            "",
            (10, 40),
            ["has no class 'Sca'", "'Scan'"],
        ),
        (
            'log: {command: cat, ports: {in: {subscribes: "PACKAGE.nav:Torn"}}}',
            "",
            (10, 40),
            ["the ports of 'log' cannot be read", "NameError", "Lost"],
        ),
        (
            'log: {command: cat, ports: {in: {subscribes: "PACKAGE.nav:Pose"}}}',
            "- {between: [scanner.scan, log.in]}",
            (13, 10),
            ["the types differ"],
        ),
    ],
)
def test_refuses_what_does_not_fit(
    check: Check,
    more: str,
    connector: str,
    place: tuple[int, int],
    words: list[str],
) -> None:
    (problem,) = check(more, connector)
    assert (problem.line, problem.column) == place, problem
    assert all(word in problem.message for word in words), problem


def test_a_required_port_has_one_connector(check: Check) -> None:
    more = (
        'navigator: {implementation: "PACKAGE.nav:Navigator"}\n'
        '      second: {implementation: "PACKAGE.nav:Posing"}'
    )
    connectors = (
        "- {between: [navigator.poses, localiser.poses]}\n"
        "      - {between: [navigator.poses, second.poses]}"
    )
    (problem,) = check(more, connectors)
    assert "'navigator.poses' requires one provider" in problem.message
    assert "navigator.poses-second.poses" in problem.message
    assert (problem.line, problem.column) == (15, 20)


def test_tells_every_problem(check: Check) -> None:
    more = (
        'one: {implementation: "PACKAGE.nav:Lacking"}\n'
        '      two: {implementation: "PACKAGE.nowhere:X"}\n'
        '      three: {implementation: "PACKAGE.nav:Thrice"}'
    )
    problems = check(more, "- {between: [scanner.x, localiser.y]}")
    assert len(problems) == 4 + 3
    assert [p.line for p in problems].count(12) == 3


def ring(*classes: str) -> tuple[str, str]:
    """Return components of these classes, each of which calls the next, round."""
    names = [f"c{number}" for number in range(len(classes))]
    more = [
        f'{name}: {{implementation: "PACKAGE.nav:{code}"}}'
        for name, code in zip(names, classes, strict=True)
    ]
    connectors = [
        f"- {{between: [{name}.out, {other}.into]}}"
        for name, other in zip(names, [*names[1:], names[0]], strict=True)
    ]
    return "\n      ".join(more), "\n      ".join(connectors)


@pytest.mark.parametrize("classes", [["Round"] * 2, ["Round"] * 4, ["Filling"] * 3])
def test_refuses_calls_that_go_round(check: Check, classes: list[str]) -> None:
    (problem,) = check(*ring(*classes))
    last = f"c{len(classes) - 1}.out-c0.into"
    assert "calls form a cycle: c0.out-c1.into" in problem.message
    assert f"called over {last} one-way" in problem.message
    assert problem.line == 9 + 2 * len(classes) + 2  # the last connector's


@pytest.mark.parametrize(
    "classes",
    [
        ["Round", "Letting"],
        ["Letting", "Round", "Round"],
        ["Telling", "Told"],
        ["Filling", "LettingFill"],
        ["Filling", "Passing"],
    ],
)
def test_accepts_a_ring_that_lets_others_in_or_does_not_wait(
    check: Check, classes: list[str]
) -> None:
    assert check(*ring(*classes)) == []


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("done", ()),
        ("dome", ("has no port 'dome' (did you mean 'done'?)",)),
        ("at", ("'walker.at' publishes Pose", "publishes bool")),
    ],
)
def test_an_action_ends_by_a_published_bool(
    check: Check, port: str, words: tuple[str, ...]
) -> None:
    task = f"{{name: walk, functions: [f], ends: walker.{port}}}"
    more = 'walker: {implementation: "PACKAGE.nav:Walking"}'
    found = check(more, f"\ntasks: {{t: {{actions: [{task}]}}}}")
    assert len(found) == bool(words)
    assert all(word in problem.message for problem in found for word in words)


@pytest.mark.parametrize(
    ("timer", "words"),
    [
        ("ticker.tick", []),
        ("ticker.tack", ["component 'ticker'", "'tack'", "'tick'"]),
    ],
)
def test_a_condition_is_about_a_timer_of_the_component(
    check: Check, timer: str, words: list[str]
) -> None:
    until = f"{{timer: {timer}, when: late}}"
    task = f"{{name: walk, functions: [f], until: {until}}}"
    more = 'ticker: {implementation: "PACKAGE.nav:Ticking"}'
    found = check(more, f"\ntasks: {{t: {{actions: [{task}]}}}}")
    assert len(found) == bool(words)
    assert all(word in problem.message for problem in found for word in words)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("deciding:decide", ""),
        ("deciding:decides", "has no function 'decides' (did you mean 'decide'?)"),
        ("deciding:LIMIT", "'deciding:LIMIT' is of type int, not a function"),
        ("deciding:none", "'deciding:none' has to take one argument, as in `def none"),
        ("deciding:number", ""),
        ("decidign:decide", "there is no module 'decidign'"),
    ],
)
def test_a_policys_function_can_be_called(
    tmp_path: Path, call: str, message: str
) -> None:
    (tmp_path / "deciding.py").write_text(
        "LIMIT, number = 3, int\ndef decide(seen): ...\ndef none(): ...\n",
        encoding="utf-8",
    )
    file = tmp_path / "robot.yaml"
    file.write_text(
        "robot: r\ncomputers: {a: {cpu: 1, memory: 1 GiB}}\n"
        f"policies: {{mine: {{call: '{call}'}}}}\n",
        encoding="utf-8",
    )
    findings = check_code(load_source(file).robot)
    assert [f.path for f in findings] == [("policies", "mine", "call")] * bool(message)
    assert all(message in finding.message for finding in findings)


STARTING = """
from poise import Component, Message, Published, Required, StartedCall
from poise import every, subscribed

class Pose(Message):
    x: float

class Poses:
    def pose(self, at: float) -> Pose: ...

class Starting(Component):
    left: Required[Poses]
    right: Required[Poses]
    both: Required[Poses]
    told: Published[Pose]
    found: Published[Pose]

    @every(0.1)
    def go_on(self) -> None:
        self.start_call(self.left.pose, 1.0).then(self.take)
        self.start_call(self.right.pose, 1.0).then(lambda call: self.take(call))
        self.both.pose(1.0)
        self.start_call(self.both.pose, 2.0)
        self.told.publish(Pose(1.0))

    @every(0.1)
    def wait(self) -> None:
        first = self.start_call(self.left.pose, 1.0)
        second = self.start_call(self.right.pose, 1.0)
        self.told.publish(Pose(first.result().x + second.result().x))

    @every(0.1)
    def look(self) -> None:
        if self.asked.done():
            self.found.publish(self.asked.result())
        self.asked = self.start_call(self.left.pose, 1.0)

    def take(self, call: StartedCall[Pose]) -> None:
        self.found.publish(call.result())

    @subscribed(block=3)
    def heard(self, message: Pose) -> None: ...
"""


def test_the_code_says_which_calls_it_starts_and_whether_it_waits_for_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starting_parts.py").write_text(STARTING)
    monkeypatch.syspath_prepend(tmp_path)
    entry = ComponentEntry(name="one", implementation="starting_parts:Starting")
    code = code_of(entry, str(tmp_path))
    assert code.sends == {
        "go_on": ("both", "left", "right", "told"),
        "wait": ("left", "right", "told"),
        "look": ("found", "left"),
        "answer": ("found",),
        "heard": (),
    }
    assert (code.keep, code.blocks) == ({}, ("heard",))
    assert code.starts == {
        "go_on": {"left": False, "right": False},
        "wait": {"left": True, "right": True},
        "look": {"left": False},
    }
