"""Placements whose data is in time, where another would be better by all else."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest
from msgspec.structs import replace

from poise import plan
from poise.estimate.profiles import Profile
from poise.model import load
from poise.model.robot import Action, Architecture, ComponentEntry, Task
from poise.runtime.code_check import code_of
from poise.session import nothing
from poise.session.placing import by_time
from poise.session.placing.first_phase import first_phase
from poise.session.placing.placement import Placement, decided, place, problem_of_task
from poise.session.render.plan_tables import plan_parts
from poise.simulation.workload import LEFT_OUT
from tests.command import run_poise

CODE = """
import poise


class Datum(poise.Message):
    number: int


class Eye(poise.Component):
    seen: poise.Published[Datum]

    @poise.every(0.1)
    def look(self):
        self.seen.publish(Datum(1))


class Mind(poise.Component):
    wish: poise.Published[Datum]

    @poise.subscribed(keep=1)
    def seen(self, datum: Datum):
        self.wish.publish(datum)


class Arm(poise.Component):
    @poise.subscribed(keep=1)
    def wish(self, datum: Datum):
        pass


class Beat(poise.Component):
    @poise.every(0.02, deadline=0.005)
    def beat(self):
        pass


class Hog(poise.Component):
    @poise.every(0.1)
    def toil(self):
        pass
"""
FILE = """
robot: some
computers: {{a: {{cpu: 50%, memory: 1 GiB}}, b: {{cpu: 50%, memory: 1 GiB}}}}
devices: {{camera: {{computer: a}}, motor: {{computer: a}}}}
links: [{{between: [a, b], {link}}}]
architectures:
  servo:
    function: servo
    components:
      eye: {{implementation: "{module}:Eye", cpu: 10%, devices: [camera]}}
      mind: {{implementation: "{module}:Mind", cpu: {mind}}}
      arm: {{implementation: "{module}:Arm", cpu: 5%, devices: [motor]}}
      hog: {{implementation: "{module}:Hog", cpu: {hog}, devices: [{hog_needs}]}}
      beat: {{implementation: "{module}:{beats}", cpu: 1%, devices: [motor]}}
    connectors:
      - {{between: [eye.seen, mind.seen], message: {message}, rate: {rate}}}
      - {{between: [mind.wish, arm.wish], message: 100 B, rate: {rate}}}
objective: {{communication: {communication}, balance: 0.5}}
{chains}
tasks: {{go: {{actions: [{{name: go, functions: [servo]}}]}}}}
"""
CHAIN = "chains: {see: {through: [eye, mind, arm], deadline: 100 ms}}"


Place = Callable[..., Placement]


@pytest.fixture
def placed(tmp_path: Path) -> Place:
    """Return what writes a robot and places it."""
    module = f"servo_of_{tmp_path.name}"
    (tmp_path / f"{module}.py").write_text(textwrap.dedent(CODE))

    def write(method: str = "auto", **keys: str) -> Placement:
        path = tmp_path / "robot.yaml"
        usual = {
            "link": "latency: 0.1 ms",
            "mind": "10%",
            "message": "100 B",
            "communication": "0.05",
            "hog": "0%",
            "hog_needs": "",
            "chains": CHAIN,
            "beats": "Arm",
            "rate": "10 Hz",
        }
        path.write_text(FILE.format(module=module, **(usual | keys)))
        robot = load(path)
        code = {c.name: code_of(c, robot.folder) for c in robot.components()}
        return place(replace(robot, code=code), "go", method=method)

    return write


@pytest.mark.parametrize(
    "keys",
    [
        {"link": "latency: 80 ms"},
        {"link": "bandwidth: 8 Mbit/s", "message": "90 kB"},
    ],
    ids=["latency", "bandwidth"],
)
def test_a_chain_does_not_cross_a_link_that_takes_too_long(
    placed: Place, keys: dict[str, str]
) -> None:
    """Without the chain its middle goes where more is free."""
    assert placed(**keys, chains="")["mind"] == "b"
    found = placed(**keys)
    assert found["mind"] == "a"
    (chain,) = found.predicted["go"].chains
    assert chain.p99 < chain.deadline


def test_a_chain_goes_round_a_busy_computer(placed: Place) -> None:
    """Only a simulation tells how much longer things take there."""
    keys = {"hog": "22%", "hog_needs": "motor", "communication": "0.5"}
    assert placed(**keys, chains="")["mind"] == "a"
    assert placed(**keys)["mind"] == "b"


def test_a_chain_is_no_longer_simulated_after_ctrl_c(
    placed: Place, tmp_path: Path
) -> None:
    placed()

    def interrupted() -> None:
        raise KeyboardInterrupt

    robot = load(tmp_path / "robot.yaml")
    code = {c.name: code_of(c, robot.folder) for c in robot.components()}
    robot = replace(robot, code=code)
    problem = problem_of_task(robot, "go", at_once=False)
    with pytest.raises(KeyboardInterrupt):
        decided(robot, problem, "greedy", plan.solve_phases, interrupted)


def test_a_chain_that_is_late_anywhere_is_placed_and_said(placed: Place) -> None:
    found = placed(chains=CHAIN.replace("100 ms", "1 ms"))
    assert found.feasible
    (chain,) = found.predicted["go"].chains
    assert chain.late == 1.0
    assert chain.margin < 0
    assert found.result.objective is not None
    assert found.result.objective.time > 1.0
    said = " ".join(str(found).split())
    assert (
        "chain 'see' misses its deadline: 100% of its data is older than 1 ms" in said
    )
    assert "misses its deadline" not in str(placed())


def test_a_chain_that_is_late_in_some_robots_only_is_said(placed: Place) -> None:
    """The mean of their 99th percentiles may be within the deadline."""
    found = placed(chains=CHAIN)
    predicted = found.predicted["go"]
    (chain,) = predicted.chains
    assert chain.margin > 0
    some = replace(predicted, chains=(replace(chain, late=0.25),))
    (said,) = (
        part
        for part in plan_parts(found.task_result, {"go": some})
        if isinstance(part, str) and "misses its deadline" in part
    )
    assert "25% of its data is older than 100 ms" in said


def test_nothing_is_suspended_so_that_less_is_late(tmp_path: Path) -> None:
    """All fits in one way, which the greedy does not find: it suspends a function."""
    needs = {"a": 0.6, "b": 0.4, "c": 0.4, "d": 0.3, "e": 0.3}
    functions = ", ".join(
        f"{name}: {{function: {name}, components: {{{name}1: {{cpu: {cpu}}}}}}}"
        for name, cpu in needs.items()
    )
    (tmp_path / "robot.yaml").write_text(f"""
robot: full
computers: {{one: {{cpu: 1, memory: 1 GiB}}, two: {{cpu: 1, memory: 1 GiB}}}}
architectures: {{{functions}}}
connectors: [{{between: [a1, e1], message: 1 kB, rate: 10 Hz}}]
chains: {{see: {{through: [a1, e1], deadline: 1 ms}}}}
""")
    robot = load(tmp_path / "robot.yaml")
    assert place(robot, method="greedy", fewer=True).result.suspended
    found = place(robot, fewer=True)
    assert found.result.suspended == ()
    assert found.task_result.bound is not None
    assert found.task_result.total is not None
    assert found.task_result.bound <= found.task_result.total


@pytest.mark.slow
def test_a_plan_knows_of_deadlines_that_only_the_code_declares(
    placed: Place, tmp_path: Path
) -> None:
    """`poise plan` read no code of a robot without chains, `poise up` does."""
    (timer,) = placed(beats="Beat", chains="").predicted["go"].timers
    assert timer.deadline == 0.005
    done = run_poise("plan", tmp_path / "robot.yaml", "--task", "go", "--json")
    (planned,) = json.loads(done.stdout)["predicted"]["go"]["timers"]
    assert planned["timer"] == "beat"


def test_tasks_that_start_together_are_placed_by_deadlines(
    placed: Place, tmp_path: Path
) -> None:
    placed(beats="Beat", chains="")
    robot = load(tmp_path / "robot.yaml")
    code = {c.name: code_of(c, robot.folder) for c in robot.components()}
    other = ComponentEntry(name="other", demand={"cpu": 0.1})
    also = Architecture(name="also", function="also", components=(other,))
    task = Task(name="also", actions=(Action(name="also", functions=("also",)),))
    robot = replace(
        robot,
        code=code,
        architectures=(*robot.architectures, also),
        tasks=(*robot.tasks, task),
    )
    found = first_phase(robot, ["go", "also"], None, nothing).placed
    assert found.where.keys() == {c.name for c in robot.components()}
    (predicted,) = found.predicted.values()
    assert [timer.timer for timer in predicted.timers] == ["beat"]


@pytest.mark.parametrize("hog", ["25%", "30%"])
def test_nothing_is_proven_that_another_placement_refutes(
    placed: Place, tmp_path: Path, hog: str
) -> None:
    keys = {"hog": hog, "mind": "0.1%", "beats": "Beat", "link": "latency: 30 ms"}
    found, given = [placed(**keys).result], tmp_path / "given.yaml"
    for mind, at in product("ab", repeat=2):
        given.write_text(f"{{eye: a, mind: {mind}, arm: a, hog: {at}, beat: a}}")
        found.append(placed(**keys, method=str(given)).result)
    totals = [each.objective.total for each in found if each.objective]
    for each, total in zip(found, totals, strict=True):
        assert each.bound is None or each.bound <= min(totals) + 1e-9
        assert not each.proven or total <= min(totals) + 1e-9


SIX = """
robot: six
computers: {{a: {{cpu: 43.6%, memory: 1 GiB}}, b: {{cpu: 43.6%, memory: 1 GiB}}}}
devices: {{camera: {{computer: b}}}}
links: [{{between: [a, b], latency: 0.2 ms}}]
architectures:
  all:
    function: all
    components:
      c0: {{implementation: "{module}:Eye", cpu: 5%, devices: [camera]}}
      c1: {{implementation: "{module}:Mind", cpu: 10%, isolated: true}}
      c2: {{implementation: "{module}:Arm", cpu: 10%, isolated: true}}
      h1: {{implementation: "{module}:Hog", cpu: 10%, isolated: true}}
      h0: {{implementation: "{module}:Sloth", cpu: 30%, isolated: true}}
      beat: {{implementation: "{module}:Beat", cpu: 2%, isolated: true}}
    connectors:
      - {{between: [c0.seen, c1.seen], message: 200 B, rate: 20 Hz}}
      - {{between: [c1.wish, c2.wish], message: 200 B, rate: 20 Hz}}
chains: {{see: {{through: [c0, c1, c2], deadline: 120 ms}}}}
tasks: {{go: {{actions: [{{name: go, functions: [all]}}]}}}}
"""


@pytest.mark.slow
def test_no_placement_of_six_components_is_better_by_simulation(tmp_path: Path) -> None:
    """The sums alone leave `beat` late beside `h0`."""
    module = f"six_of_{tmp_path.name}"
    code = CODE.replace("deadline=0.005", "deadline=0.008")
    code = code.replace("every(0.1)\n    def look", "every(0.05)\n    def look")
    sloth = "class Sloth(poise.Component):\n    @poise.every(0.3)\n"
    code += sloth + "    def toil(self):\n        pass\n"
    (tmp_path / f"{module}.py").write_text(code)
    path, given = tmp_path / "robot.yaml", tmp_path / "given.yaml"
    path.write_text(SIX.format(module=module))
    robot = load(path)
    code_by_name = {c.name: code_of(c, robot.folder) for c in robot.components()}
    robot = replace(robot, code=code_by_name)
    totals = []
    for at in product("ab", repeat=5):
        names = zip(("c1", "c2", "h0", "h1", "beat"), at, strict=True)
        given.write_text(json.dumps({"c0": "b", **dict(names)}))
        result = place(robot, "go", method=str(given)).result
        if result.feasible and result.objective:
            totals.append(result.objective.total)
    best = place(robot, "go").result
    assert best.objective is not None
    assert best.objective.total == pytest.approx(min(totals))


def test_what_was_not_measured_is_said_to_be_a_guess(
    placed: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    guess = "no profile was measured: the ages are guessed from the CPU that components"
    assert guess in str(placed())
    profile = Profile(
        robot="some", poise="", computer="", speed=1.0, at="", seconds=1.0
    )
    monkeypatch.setattr(by_time, "read_profile", lambda _: profile)
    assert guess not in str(placed())


def test_a_given_placement_is_predicted_as_it_is(placed: Place, tmp_path: Path) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("{eye: a, mind: b, arm: a, hog: a, beat: a}")
    found = placed(method=str(given), link="latency: 80 ms")
    assert found["mind"] == "b"
    (chain,) = found.predicted["go"].chains
    assert chain.median > 0.16
    assert found.result.objective is not None
    assert found.result.objective.time > 0.5


def test_a_timer_with_a_deadline_is_placed_so_that_it_keeps_it(placed: Place) -> None:
    """Beside a hog it would miss it; without the deadline the hog is beside it."""
    keys = {"hog": "30%", "mind": "0.1%", "chains": "", "communication": "0.0"}
    assert placed(**keys, hog_needs="motor")["hog"] == "a"
    beside = placed(**keys, beats="Beat", hog_needs="motor")
    (timer,) = beside.predicted["go"].timers
    assert (timer.name, timer.late > 0.05) == ("beat.beat", True)
    assert beside.result.objective is not None
    assert beside.result.objective.time > 1.0
    apart = placed(**keys, beats="Beat")
    assert apart["hog"] == "b"
    assert apart.result.objective is not None
    assert apart.result.objective.time == 0.0


def test_a_chain_that_is_not_predicted_counts_what_it_takes_at_least(
    placed: Place,
) -> None:
    """Nothing is known to go over its connectors, and its wire is known to be slow."""
    keys = {"link": "latency: 80 ms", "rate": "0 Hz", "communication": "0.05"}
    assert placed(**keys, chains="")["mind"] == "b"
    found = placed(**keys)
    assert found["mind"] == "a"
    assert found.predicted["go"].unknown == ("see",)
    assert "not predicted: see, at least" in " ".join(str(found).split())


def test_what_is_not_predicted_names_its_phase_and_each_reason_once(
    placed: Place, tmp_path: Path
) -> None:
    placed(rate="0 Hz")
    robot = load(tmp_path / "robot.yaml")
    code = {c.name: code_of(c, robot.folder) for c in robot.components()}
    (go,) = robot.actions("go")
    tasks = (Task(name="go", actions=(go, replace(go, name="come"))),)
    found = place(replace(robot, code=code, tasks=tasks), "go")
    said = " ".join(str(found).split())
    assert "not predicted in go: see, at least" in said
    assert "not predicted in come: see, at least" in said
    assert said.count("no profile was measured") == 1


def test_says_which_timers_were_late_by_what_is_not_predicted(placed: Place) -> None:
    found = placed()
    late = f"'mind.think' missed 40% of its deadlines when it was profiled: {LEFT_OUT}"
    predicted = replace(found.predicted["go"], guesses=(late, "another one"))
    *_, last = plan_parts(found.task_result, {"go": predicted})
    assert last == f"[yellow]assumed: {late}[/]"


def test_a_placement_that_is_late_says_how_long_deciding_took(placed: Place) -> None:
    keys = {"hog": "25%", "mind": "0.1%", "beats": "Beat"}
    found = placed(**keys, chains=CHAIN.replace("100 ms", "1 ms")).result
    assert found.objective is not None
    assert found.objective.time > 1.0
    assert found.seconds > 0.0
