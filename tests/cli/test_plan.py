"""`poise plan`, as a person or a script calls it."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from poise.cli.plan_command import plan_command
from poise.errors import UsageError

ROBOT = Path(__file__).parents[2] / "examples" / "paper" / "robot.yaml"

PROBLEM = """
{"components": [{"name": "a", "demand": {"cpu": 1}},
                {"name": "b", "demand": {"cpu": 1}, "only": ["two"]}],
 "computers": [{"name": "one", "capacity": {"cpu": 2}},
               {"name": "two", "capacity": {"cpu": 1}}],
 "connectors": [{"between": ["a", "b"], "overhead": 1}]}
"""


BALANCED = {"a": 0.3, "b": 0.1, "c": 0.2, "d": 0.2}


def call(*arguments: object) -> Result:
    app = typer.Typer()
    app.command()(plan_command)
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    path = tmp_path / "problem.json"
    path.write_text(PROBLEM)
    return path


def test_the_papers_example_shows_what_the_greedy_tried() -> None:
    result = call(ROBOT, "--method", "greedy", "--json")
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    tried = [[trial["total"] for trial in step["trials"]] for step in answer["trace"]]
    assert tried[1:] == [[60, 27.5], [47.5, 22.5]]
    assert answer["objective"]["total"] == 22.5
    assert answer["feasible"]
    assert answer["trace"][2]["chosen"] == answer["placement"]["C3"]


def test_a_plain_problem_is_placed(problem_file: Path) -> None:
    answer = json.loads(call(problem_file, "--json").stdout)
    assert answer["placement"] == {"a": "one", "b": "two"}


def test_people_see_the_placement(problem_file: Path) -> None:
    text = call(problem_file).stdout
    assert "one" in text
    assert "F = " in text
    assert "0 is best" in text


@pytest.mark.parametrize(
    "options", [(), ("--compare", "greedy,auto"), ("--smallest",), ("--explain", "[/]")]
)
def test_names_with_brackets_are_shown_as_they_are(
    tmp_path: Path, options: tuple[str, ...]
) -> None:
    """A plain problem may have any names; `[/]` is no end of a style."""
    path = tmp_path / "problem.json"
    path.write_text(PROBLEM.replace('"a"', '"[/]"').replace('"one"', '"pc[red]"'))
    result = call(path, *options)
    assert result.exit_code == 0, result.exception
    assert "pc[red]" in result.stdout


def test_people_see_some_of_very_many_names(tmp_path: Path) -> None:
    """Of 1,000 on one computer 25 are named; JSON has them all."""
    names = ", ".join(f'{{"name": "c{i}"}}' for i in range(1000))
    path = tmp_path / "many.json"
    path.write_text(f'{{"components": [{names}], "computers": [{{"name": "one"}}]}}')
    said = call(path).stdout
    assert "and 975 more" in " ".join(said.replace("│", " ").split())
    assert len(json.loads(call(path, "--json").stdout)["placement"]) == 1000


def test_a_problem_without_a_solution_exits_with_1(tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    path.write_text(PROBLEM.replace('"capacity": {"cpu": 1}', '"capacity": {}'))
    result = call(path, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["feasible"] is False


def test_says_why_a_component_is_where_it_is() -> None:
    result = call(ROBOT, "--explain", "C3", "--json")
    options = json.loads(result.stdout)["explanation"]["options"]
    assert [round(option["objective"]["total"], 9) for option in options] == [
        22.5,
        47.5,
    ]


def test_compares_methods_side_by_side() -> None:
    result = call(ROBOT, "--compare", "static,greedy,search,exact", "--json")
    results = json.loads(result.stdout)["results"]
    assert results["static"]["objective"]["total"] == 75
    assert results["exact"]["proven"]
    text = call(ROBOT, "--compare", "static,greedy").stdout
    assert "█" in text


def test_a_comparison_shows_no_load_where_there_is_no_placement() -> None:
    said = call(ROBOT, "--compare", "static,auto", "--scale", "cpu=0.2").stdout
    rows = [line.split() for line in said.splitlines()]
    (cpu,) = (row for row in rows if row[:2] == ["sbc1", "cpu"])
    assert "%" in cpu[-2]
    assert cpu[-1] == "-"


def test_five_methods_fit_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """In 80 columns, each row on one line: without bars."""
    monkeypatch.setenv("COLUMNS", "80")
    text = call(ROBOT, "--compare", "static,greedy,exact,search,auto").stdout
    terms = [line for line in text.splitlines() if line.startswith("communication ")]
    assert len(terms[0].split()) == 6
    assert max(map(len, text.splitlines())) <= 80
    assert "█" not in text


def test_asks_what_if(problem_file: Path) -> None:
    more = call(problem_file, "--add", "three:cpu=200%,memory=4GiB", "--json")
    assert json.loads(more.stdout)["feasible"]
    less = call(problem_file, "--scale", "CPU=0.1", "--json")
    assert less.exit_code == 1
    assert "cpu" in json.loads(less.stdout)["reason"]
    fewest = call(problem_file, "--smallest", "--json")
    assert json.loads(fewest.stdout)["computers"] == ["one", "two"]


def test_says_which_alternative_needs_the_computer_that_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "held.json"
    path.write_text(
        '{"components": [{"name": "a", "only": ["one"]}, {"name": "b"}],'
        ' "computers": [{"name": "one"}, {"name": "two"}], "architectures": ['
        '{"name": "good", "components": ["a"], "function": "see"},'
        '{"name": "plain", "components": ["b"], "function": "see", "quality": 0.5}]}'
    )
    found = call(path, "--without", "one", "--json")
    assert json.loads(found.stdout)["placement"] == {"b": "two"}
    assert "without one, good can run nowhere, but an alternative can" in found.stderr


@pytest.mark.parametrize(
    "wrong",
    [
        ("--without", "two"),
        ("--without", "nowhere"),
        ("--add", "three"),
        ("--add", "three:cpu=much"),
        ("--scale", "cpu=-1"),
        ("--scale", "gpu=2"),
        ("--task", "dance"),
        ("--method", "magic"),
        ("--budget", "nan"),
        ("--explain", "nobody"),
        ("--compare", "static"),
    ],
)
def test_refuses_what_it_cannot_do(problem_file: Path, wrong: tuple[str, str]) -> None:
    result = call(problem_file, *wrong)
    assert isinstance(result.exception, UsageError)


@pytest.mark.parametrize("option", ["--method", "--compare"])
def test_an_unknown_method_is_answered_with_all(
    problem_file: Path, option: str
) -> None:
    error = call(problem_file, option, "fast").exception
    assert "auto, greedy, exact, search, static" in str(error)


@pytest.mark.parametrize("other", [("--explain", "a"), ("--smallest",)])
def test_a_comparison_refuses_what_is_about_one_method(
    problem_file: Path, other: tuple[str, ...]
) -> None:
    result = call(problem_file, "--compare", "greedy,search", *other)
    assert isinstance(result.exception, UsageError)
    assert f"--compare and {' '.join(other)} exclude" in str(result.exception)


def test_shows_what_was_put_aside(tmp_path: Path) -> None:
    path = tmp_path / "tight.json"
    path.write_text(
        '{"components": [{"name": "a", "demand": {"cpu": 2}},'
        ' {"name": "b", "demand": {"cpu": 2}}],'
        ' "computers": [{"name": "one", "capacity": {"cpu": 3}}],'
        ' "architectures": [{"name": "A", "components": ["a"], "priority": 1},'
        ' {"name": "B", "components": ["b"]}]}'
    )
    assert call(path).exit_code == 1
    result = call(path, "--fewer")
    assert result.exit_code == 0
    said = " ".join(result.stdout.split())
    assert "suspended: B (not everything fits: a, b together need 4 cpu" in said
    assert "not feasible" not in said


PHASES = """
robot: waiter
computers:
  left: {cpu: 50%, memory: 1 GiB, price: 2}
  right: {cpu: 50%, memory: 1 GiB, price: 3}
architectures:
  see: {function: seeing, components: {eyes: {cpu: 30%}}}
  drive: {function: driving, components: {wheels: {cpu: 30%}}}
  talk: {function: talking, components: {mouth: {cpu: 30%}}}
tasks:
  serve:
    actions:
      - {name: look, functions: [seeing]}
      - {name: go, functions: [seeing, driving], limit: 90 s}
  talk: {actions: [{name: talk, functions: [talking]}]}
"""


@pytest.fixture
def phases_file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_text(PHASES)
    return path


def test_phases_of_a_task_are_shown_side_by_side(phases_file: Path) -> None:
    said = call(phases_file, "--task", "serve")
    assert said.exit_code == 0, said.output
    rows = [line.split() for line in said.stdout.splitlines()]
    assert rows[0] == ["phase", "weight", "left", "right", "F"]
    fits = [row[:2] for row in rows if row[-1:] == ["fits"]]
    assert fits == [["look", "25%"], ["go", "75%"]]
    assert "assumed: look takes 30 s, as it has no limit" in said.stdout
    answer = json.loads(call(phases_file, "--task", "serve", "--json").stdout)
    assert [phase["name"] for phase in answer["phases"]] == ["look", "go"]
    assert answer["phases"][1]["after"] == {"look": 1}
    assert [phase["lasts"] for phase in answer["phases"]] == [30, 90]
    assert [phase["weight"] for phase in answer["phases"]] == [0.25, 0.75]
    assert answer["assumed"] == ["look takes 30 s, as it has no limit"]
    assert answer["phases"][1]["placement"].keys() == {"eyes", "wheels"}
    assert answer["feasible"]
    assert answer["moves"] == []


def test_a_phase_that_does_not_fit_says_why(phases_file: Path) -> None:
    said = call(phases_file, "--task", "serve", "--without", "right")
    assert said.exit_code == 1
    assert "phase 'go': eyes, wheels together need 0.6 cpu" in " ".join(
        said.stdout.split()
    )


def test_a_phase_says_what_is_suspended_in_it(phases_file: Path) -> None:
    said = call(phases_file, "--task", "serve", "--without", "right", "--fewer").stdout
    assert "suspended in go: " in said
    assert "suspended in look" not in said
    assert "not everything fits: phase 'go'" in said


def test_a_phase_says_where_cpu_is_short_in_it(phases_file: Path) -> None:
    said = call(phases_file, "--task", "serve", "--without", "right", "--share")
    assert said.exit_code == 0, said.output
    rows = [line.split() for line in said.stdout.splitlines()]
    assert [row[0] for row in rows if row[-1:] == ["fits"]] == ["look"]
    assert [row[0] for row in rows if row[-2:] == ["is", "short"]] == ["go"]
    assert "short on left in go: 0.1 cores of cpu" in said.stdout
    assert "in look" not in said.stdout


def test_explains_a_component_in_a_phase(phases_file: Path) -> None:
    asked = (phases_file, "--task", "serve", "--explain", "eyes", "--phase", "go")
    answer = json.loads(call(*asked, "--json").stdout)
    assert answer["phase"] == "go"
    assert answer["explanation"]["component"] == "eyes"
    assert "phase go:" in call(*asked).stdout


def test_the_cheapest_computers_for_tasks(phases_file: Path) -> None:
    one = json.loads(call(phases_file, "--smallest", "--task", "talk", "--json").stdout)
    assert one["computers"] == ["left"]
    both = call(phases_file, "--smallest")
    assert "fits on 2, price 5: left, right; no cheaper set will do" in both.stdout
    answer = json.loads(
        call(
            phases_file, "--smallest", "--task", "talk", "--task", "serve", "--json"
        ).stdout
    )
    assert answer["price"] == 5
    assert list(answer["tasks"]) == ["talk", "serve"]


def test_a_high_price_is_not_rounded(phases_file: Path) -> None:
    phases_file.write_text(PHASES.replace("price: 2", "price: 1234567.25"))
    said = call(phases_file, "--smallest", "--task", "serve").stdout
    assert "fits on 2, price 1234570.25: left, right" in said


def test_where_nothing_fits_the_cheapest_computers_say_what_is_missing(
    tmp_path: Path,
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("""
robot: full
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  servo: {function: servo, components: {eye: {cpu: 60%}, arm: {cpu: 60%}}}
tasks: {go: {actions: [{name: go, functions: [servo]}]}}
""")
    said = call(path, "--smallest").stdout
    assert said == call(path, "--task", "go").stdout
    assert "It would fit with 0.2 more cpu on one" in said


def test_the_cheapest_computers_say_what_will_be_late_there(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("""
robot: slow
computers: {one: {cpu: 1, memory: 1 GiB}}
architectures:
  servo:
    function: servo
    components: {eye: {cpu: 10%}, arm: {cpu: 45%}}
    connectors: [{between: [eye, arm], message: 1 kB, rate: 10 Hz}]
chains: {see: {through: [eye, arm], deadline: 3 ms}}
tasks: {go: {actions: [{name: go, functions: [servo]}]}}
""")
    late = "chain 'see' misses its deadline: 100% of its data is older than 3 ms"
    assert late in call(path, "--smallest").stdout
    answer = json.loads(call(path, "--smallest", "--json").stdout)
    (chain,) = answer["tasks"]["go"]["predicted"]["go"]["chains"]
    assert (chain["name"], chain["late"]) == ("see", 1.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ("--task", "talk", "--task", "serve"),
            "several tasks are planned together only with --smallest",
        ),
        (("--task", "serve", "--compare", "static,auto"), "add --at-once"),
        (("--compare", "auto", "--method", "static"), "add static to --compare"),
        (("--task", "serve", "--method", "p.yaml"), "a file places all at once"),
        (("--task", "dance"), "no task 'dance'"),
        (("--smallest", "--explain", "eyes"), "run --smallest first"),
        (("--task", "talk", "--explain", "mouth", "--phase", "talk"), "no phases"),
        (("--task", "serve", "--phase", "go"), "works only together with --explain"),
        (("--at-once",), "needs exactly one --task"),
    ],
)
def test_refuses_what_phases_do_not_have(
    phases_file: Path, options: tuple[str, ...], words: str
) -> None:
    result = call(phases_file, *options)
    assert isinstance(result.exception, UsageError)
    assert words in str(result.exception)


def test_all_of_a_task_at_once(phases_file: Path) -> None:
    answer = json.loads(
        call(phases_file, "--task", "serve", "--at-once", "--json").stdout
    )
    assert answer["placement"].keys() == {"eyes", "wheels"}


def test_rounding_is_no_cost(tmp_path: Path) -> None:
    components = [{"name": n, "demand": {"cpu": cpu}} for n, cpu in BALANCED.items()]
    computers = [{"name": n, "capacity": {"cpu": 1}} for n in ("one", "two")]
    path = tmp_path / "problem.json"
    path.write_text(json.dumps({"components": components, "computers": computers}))
    result = call(path)
    assert "F = 0 = communication 0 + balance 0" in result.output


def test_says_why_a_component_has_no_placement_and_refuses_one_that_is_none(
    tmp_path: Path,
) -> None:
    path = tmp_path / "problem.json"
    path.write_text(PROBLEM.replace('"capacity": {"cpu": 1}', '"capacity": {}'))
    result = call(path, "--explain", "b")
    assert result.exit_code == 1
    assert "no placement" in result.stdout
    wrong = call(path, "--explain", "nobody")
    assert isinstance(wrong.exception, UsageError)
    assert "no component is called 'nobody' (there are: a, b)" in str(wrong.exception)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--smallest", "--fewer"), "--smallest and --fewer exclude each other"),
        (
            ("--scale", "one=0.5", "--scale", "one=2"),
            "--scale one=0.5 and --scale one=2 are about the same",
        ),
        (
            ("--scale", "one=0.5", "--scale", "ONE=2"),
            "'one' and 'ONE' mean the same",
        ),
        (("--add", "x:cpu=1,cpu=2"), "cpu is both 1 and 2; name it once"),
        (("--add", "x:cpus=1"), "no resource 'cpus' (did you mean 'cpu'?)"),
    ],
)
def test_refuses_what_contradicts_itself(
    problem_file: Path, options: tuple[str, ...], said: str
) -> None:
    result = call(problem_file, *options)
    assert isinstance(result.exception, UsageError)
    assert said in str(result.exception)


def test_the_phase_that_has_the_component_says_why_it_has_no_placement(
    phases_file: Path,
) -> None:
    """`wheels` are only in the phase `go`, which does not fit."""
    asked = (phases_file, "--task", "serve", "--without", "right")
    said = call(*asked, "--explain", "wheels")
    assert said.exit_code == 1, said.output
    assert "phase 'go': eyes, wheels together need 0.6 cpu" in " ".join(
        said.stdout.split()
    )
    wrong = call(*asked, "--explain", "wings")
    assert isinstance(wrong.exception, UsageError)
    assert "there are: eyes, see, wheels, drive" in str(wrong.exception)


def test_lines_are_not_broken_where_no_terminal_is(problem_file: Path) -> None:
    lines = call(problem_file).stdout.splitlines()
    (total,) = (line for line in lines if line.startswith("F = "))
    assert "; by " in total


def test_a_file_s_name_is_no_markup(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    computers = "{a: {cpu: 1, memory: 1 GiB}}"
    text = f"robot: r\ncomputers: {computers}\nprofile: 'new[/a].yaml'\n"
    path.write_text(text)
    result = call(path)
    assert result.exit_code == 0, result.exception
    assert "new[/a].yaml does not exist: `poise profile` measures it" in result.stderr


def test_a_plain_problem_has_no_arguments(problem_file: Path) -> None:
    result = call(problem_file, "--set", "side=left")
    assert isinstance(result.exception, UsageError)
