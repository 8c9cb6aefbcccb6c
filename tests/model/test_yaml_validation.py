"""Every structural problem is found, at its place, with the value and the choices."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

COMPUTERS = "computers: {main: {cpu: 1, memory: 1 GiB}}\n"


def robot(rest: str) -> str:
    """Return a robot file that is right but for `rest`."""
    return f"robot: r\n{COMPUTERS}{rest}\n"


def component(text: str) -> str:
    """Return a robot file that is right but for a component."""
    return robot(f"architectures: {{x: {{function: f, components: {{c: {text}}}}}}}")


def test_accepts_the_smallest_robot(find: Find) -> None:
    assert find(robot("")) == ()


def test_refuses_an_unknown_key_and_lists_the_keys(refuse: Refuse) -> None:
    refuse(
        "robot: r\ncomputers: {main: {cpu: 1, memory: 1, ▸sped: 2}}\n",
        "computers.main.sped",
        "unknown key 'sped'",
        "did you mean 'speed'?",
        "'address'",
    )


def test_refuses_a_missing_key(refuse: Refuse) -> None:
    refuse(
        "robot: r\ncomputers: {▸main: {cpu: 1}}\n",
        "computers.main: the key 'memory' is missing",
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "▸robot: 2 b\n" + COMPUTERS,
            ["robot: '2 b'", "a letter of a-z or A-Z, then up"],
        ),
        (f'▸robot: "r\\n"\n{COMPUTERS}', [r"'r\n'", "a letter"]),
        ("robot: r\n▸computers: {}\n", ["has 0 entries", "at least 1"]),
        ("robot: r\n▸computers: main\n", ["must be a mapping", "not 'main'"]),
        ("robot: r\n▸computers:\n", ["must be a mapping", "not nothing"]),
        (
            "robot: r\ncomputers: {▸ä: {cpu: 1, memory: 1}}\n",
            ["computers.ä: 'ä' is not allowed", "of a-z or A-Z"],
        ),
        (
            "robot: r\ncomputers: {m: {▸cpu: 0, memory: 1}}\n",
            ["computers.m.cpu: '0' must be above 0"],
        ),
        (
            "robot: r\ncomputers: {m: {cpu: 1, memory: 1, ▸reserve: 100%}}\n",
            ["'100%' must be below 1"],
        ),
        (
            "robot: r\ncomputers: {m: {cpu: 1, memory: 1, reserve: {▸cpu: x}}}\n",
            ["computers.m.reserve.cpu: 'x' is not a share such as 5%"],
        ),
        (
            "robot: r\ncomputers: {m: {cpu: 1, memory: 1, resources: {▸cpu: 2}}}\n",
            ["'cpu'", "cpu and memory have keys of their own"],
        ),
        (robot("▸links: {a: 1}"), ["links: must be a list", "not a mapping"]),
        (robot("links: [▸3]"), ["links[0]: must be a mapping with 'between'"]),
        (
            robot("links: [{▸between: [main]}]"),
            ["must be a list of 2", "not a list of 1"],
        ),
        (robot("tasks: {t: {▸actions: []}}"), ["at least 1"]),
        (
            robot(
                "tasks: {t: {actions: [{name: a, functions: [], ▸on failure: redo}]}}"
            ),
            ["'redo' is not 'give up', nor a mapping with one of 'retry'"],
        ),
        (robot("objective: {▸balance: .nan}"), ["'.nan' is not a number"]),
        (robot("objective: {weights: {▸cpu: .inf}}"), ["'.inf' is not a number"]),
        (
            robot("objective: {▸scale: normalized}"),
            ["'normalized' is not one of", "'paper'", "did you mean 'normalised'?"],
        ),
        (robot("simulator: {▸command: 'a \"b'}"), ["not a command line", "quotation"]),
        (robot("simulator: {▸command: '  '}"), ["is empty"]),
        (robot("together: [▸[a]]"), ["together[0]: has 1 entry; it takes at least 2"]),
        (
            robot(
                "architectures: {x: {function: f, components: {a: {}, b: {}}, "
                "connectors: [{between: [a, b], ▸limit: 200 h}]}}"
            ),
            ["'200 h' must be at most 604800 s"],
        ),
        (
            robot(
                "architectures: {x: {function: f, components: {a: {}, b: {}}, "
                "connectors: [{between: [a, b], ▸rate: 1e9 Hz}]}}"
            ),
            ["'1e9 Hz' must be at most 1e+06"],
        ),
        (component("{▸cpu: 20 percent}"), ["unit 'percent'", "core, cores, %"]),
        (component("{▸memory: 20 Mib}"), ["did you mean 'MiB'?"]),
        (component("{▸memory: -1}"), ["negative"]),
        (component("{▸memory: [1]}"), ["must be a single value, not a list of 1"]),
        (component("{▸movable: yes}"), ["'yes' is neither 'true' nor 'false'"]),
        (component("{▸devices: laser}"), ["must be a list", "not 'laser'"]),
        (component("{▸implementation: a.b.C}"), ["package.module:Class"]),
        (
            component("{ports: {▸p: {publishes: 'a:B', requires: 'a:B'}}}"),
            ["has 2 entries", "at most 1"],
        ),
        (component("{ports: {p: {▸sends: 'a:B'}}}"), ["'publishes'", "'requires'"]),
        (component("{parameters: {n: 1}, ▸command: []}"), ["at least 1"]),
        (
            component("{▸parameters: {n: 99999999999999999999}}").replace(
                "▸parameters: {n", "parameters: {▸n"
            ),
            ["parameters.n: '99999999999999999999' does not fit into 64 bits"],
        ),
        (component("{parameters: {▸n: 1e999}}"), ["too large"]),
        (component("{parameters: {▸n: -.inf}}"), ["'-.inf' is no finite number"]),
        (component("{parameters: {▸n: [.NaN]}}"), ["'.NaN' is no finite number"]),
        (
            component("{parameters: {▸n: True}}"),
            ["parameters.n: 'True': write true, or put a text in quotes"],
        ),
    ],
)
def test_refuses_a_wrong_value(refuse: Refuse, text: str, words: list[str]) -> None:
    refuse(text, *words)


def test_a_bridge_to_ros_2_waits_a_week_at_most(find: Find) -> None:
    bridge = "{ros2: /x, port: a.p, limit: 1e10}"
    problems = find(robot(f"ros2: {{bridges: [{bridge}]}}"))
    assert any("must be at most 604800 s" in each.message for each in problems)


@pytest.mark.parametrize("priority", ["1.5", "1001", "high", "1" * 400])
def test_refuses_a_priority_that_is_no_small_whole_number(
    refuse: Refuse, priority: str
) -> None:
    entry = f"{{function: f, components: {{}}, ▸priority: {priority}}}"
    refuse(robot(f"architectures: {{x: {entry}}}"), "priority")


def test_tells_all_problems_at_once_in_the_order_of_the_file(find: Find) -> None:
    problems = find("robot: 1\ncomputers: {m: {cpu: x, memory: -1, z: 1}}\nfoo: 1\n")
    assert [(p.line, p.column) for p in problems] == [
        (1, 1),
        (2, 17),
        (2, 25),
        (2, 37),
        (3, 1),
    ]


def test_tells_wrong_names_beside_wrong_values(find: Find) -> None:
    problems = find(component("{cpu: 1 kB, only: [mian]}"))
    assert len(problems) == 2
    assert "unknown unit 'kB'" in problems[0].message
    assert "there is no computer 'mian'" in problems[1].message
