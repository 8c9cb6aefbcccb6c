"""ROS 2 nodes, topics and bridges in a robot file."""

from collections.abc import Callable
from pathlib import Path

import pytest

from poise.errors import FileProblem
from poise.model import load
from poise.model.check.ros2_components import ros2_environment
from poise.model.robot import Robot

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

HEAD = """
robot: r
computers: {main: {cpu: 2, memory: 1 GiB}, vision: {cpu: 2, memory: 1 GiB}}
architectures:
  nav:
    function: f
    components:
"""
SCAN = "      scan: {ros2: {package: nav_stack, executable: scan_filter}}\n"
PLAN = "      plan: {ros2: {node: 'nav.plan:Planner'}}\n"
DRIVE = "      drive: {implementation: 'nav.drive:Drive'}\n"
BRIDGE = "{ros2: /a, port: drive.a}"


def of(tmp_path: Path, text: str) -> Robot:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    return load(path)


def node_with(key: str) -> str:
    return f"      scan: {{ros2: {{executable: a, {key}}}}}\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("      scan: {▸ros2: {package: nav_stack}}\n", ["either an `executable`"]),
        ("      scan: {▸ros2: {executable: a, node: 'b:C'}}\n", ["either"]),
        (
            "      scan: {ros2: {executable: a, ▸exec: a}}\n",
            ["unknown key 'exec'", "'executable'"],
        ),
        ("      scan: {▸ros2: {node: 'b:C', arguments: [x]}}\n", ["`arguments`"]),
        (
            "      scan: {ros2: {executable: a}, ▸parameters: {b: 1}}\n",
            ["`params` under `ros2`"],
        ),
        (
            "      scan: {ros2: {node: 'b:C'}, ▸implementation: 'b:C'}\n",
            ["leave `implementation` out"],
        ),
        (
            "      scan: {implementation: 'b:C', ▸environment: {A: b}}\n",
            ["no process of its own"],
        ),
        (
            SCAN + DRIVE + "    connectors: [{▸between: [scan, drive], rate: 1 Hz}]\n",
            ["'scan'", "add `topic: /its_topic`"],
        ),
        (
            SCAN + PLAN + "    connectors: [{▸between: [scan.a, plan], topic: /a}]\n",
            ["'scan' without a port"],
        ),
        (
            SCAN + DRIVE + "    connectors: [{▸between: [scan, drive], topic: /a}]\n",
            ["'drive' is no ROS 2 node", "bridge"],
        ),
        (
            SCAN + DRIVE + "ros2: {bridges: [{ros2: /a, ▸port: scan.a}]}\n",
            ["'scan' has no Python class"],
        ),
        (
            DRIVE + "ros2: {bridges: [{ros2: /a, ▸port: driv.a}]}\n",
            ["did you mean 'drive'?"],
        ),
        (DRIVE + "ros2: {▸domain: 233}\n", ["at most 232"]),
        (node_with("params: {▸'': 1}"), ["parameter '' is no name"]),
        (node_with("params: {▸a b: 1}"), ["parameter 'a b' is no name"]),
        (node_with("params: {b: {▸1: 1}}"), ["parameter 'b.1' is no name"]),
        (node_with("params: {▸a: null}"), ["'a' is no bool, number or text"]),
        (node_with("params: {▸a: [{b: 1}]}"), ["'a' is no bool, number or text"]),
        (node_with("params: {▸a: []}"), ["'a' is an empty list"]),
        (node_with("params: {▸a: [1, 2.5]}"), ["'a' is a list of several types"]),
        (node_with("remap: {▸'': /a}"), ["'' is not allowed"]),
        (node_with("remap: {▸a: ''}"), ["'' is not allowed"]),
        (node_with("remap: {▸a: b c}"), ["'b c' is not allowed"]),
        (node_with("remap: {▸a: /b/}"), ["'/b/' is not allowed"]),
        (DRIVE + "ros2: {bridges: [{▸ros2: /a/1b, port: drive.a}]}\n", ["'/a/1b' is"]),
        (DRIVE + "ros2: {bridges: [{▸ros2: /, port: drive.a}]}\n", ["'/' is not"]),
        (node_with("remap: {▸a: '/{robot}/a'}"), ["'/{robot}/a' is not allowed"]),
        (node_with("remap: {▸a: /aä}"), ["'/aä' is not allowed"]),
        (node_with("▸name: 1a"), ["'1a' is not allowed"]),
        (node_with("▸namespace: ~/a"), ["'~/a' is not allowed"]),
        (node_with("params_files: [▸'']"), ["is empty"]),
    ],
)
def test_refuses_what_cannot_run(refuse: Refuse, text: str, words: list[str]) -> None:
    refuse(HEAD + text, *words)


@pytest.mark.parametrize(
    "key",
    [
        "params: {qos_overrides: {/tf.publisher.depth: 1}, a/b: x, c: [1.0, 2.5]}",
        "remap: {node:scan: /scan, 'rostopic://a': ~/b, ~/c: d, __node: e}",
        "remap: {a: '{ns}/x_{node}/b__', b: ~, c: _a/_}, namespace: /",
    ],
)
def test_takes_what_ros2_takes(find: Find, key: str) -> None:
    assert find(HEAD + node_with(key)) == ()


def test_two_nodes_may_share_several_topics(find: Find) -> None:
    topics = "[{between: [scan, plan], topic: /a}, {between: [scan, plan], topic: /b}]"
    assert find(f"{HEAD}{SCAN}{PLAN}    connectors: {topics}\n") == ()


def test_nodes_that_find_each_other_on_one_computer_stay_there(find: Find) -> None:
    topic = "    connectors: [{between: [scan, plan], topic: /a}]\n"
    text = f"{HEAD}{SCAN}{PLAN}{topic}ros2: {{discovery: localhost}}\n"
    assert "or keep its ends `together`" in str(find(text))
    assert find(text + "together: [[scan, plan]]\n") == ()
    assert find(text.replace("localhost", "computers")) == ()
    assert find(text.replace(", vision: {cpu: 2, memory: 1 GiB}", "")) == ()


def test_an_executable_becomes_a_command(tmp_path: Path) -> None:
    node = (
        "{package: nav, executable: scan, name: front, namespace: /a, "
        "remap: {scan: /b}, params: {rate: 10, filter: {name: low pass}}, "
        "arguments: [--fast]}"
    )
    robot = of(
        tmp_path,
        f"{HEAD}      scan: {{ros2: {node}, environment: {{A: b}}}}\n"
        "ros2: {domain: 7, discovery: localhost}\n",
    )
    scan = robot.component("scan")
    assert scan.command == (
        *("ros2:nav/scan", "--fast", "--ros-args", "-r", "__node:=front"),
        *("-r", "__ns:=/a", "-r", "scan:=/b", "--ros-args", "-p", "rate:=10"),
        *("-p", 'filter.name:="low pass"'),
    )
    assert scan.environment == {
        "A": "b",
        "ROS_DOMAIN_ID": "7",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


def test_a_script_runs_in_the_python_of_the_agent(tmp_path: Path) -> None:
    robot = of(tmp_path, f"{HEAD}      scan: {{ros2: {{executable: ./a.py}}}}\n")
    assert robot.component("scan").command == ("python", "./a.py")


def test_a_text_may_have_any_letter(tmp_path: Path) -> None:
    node = "{ros2: {executable: a, params: {face: 'é 😀'}}}"
    robot = of(tmp_path, f"{HEAD}      scan: {node}\n")
    # ROS 2 refuses letters that are written as two \\u
    assert robot.component("scan").command[-1] == 'face:="é 😀"'


def test_a_node_may_have_a_parameter_of_any_name(tmp_path: Path) -> None:
    node = "{ros2: {node: 'nav.plan:Planner', params: {ros2: {rate: 5}}}}"
    (plan,) = of(tmp_path, f"{HEAD}      plan: {node}\n").components()
    start, *params = plan.parameters.items()
    assert start[1]["node"] == "nav.plan:Planner"
    assert params == [("ros2", {"rate": 5})]


def test_a_bridge_becomes_a_component_beside_the_one_with_the_port(
    tmp_path: Path,
) -> None:
    robot = of(
        tmp_path, f"{HEAD}{DRIVE}ros2: {{bridges: [{{ros2: /a, port: drive.a}}]}}\n"
    )
    bridge = robot.component("drive-a-ros2")
    assert bridge.parameters["port"] == "a"
    assert [each["ros2"] for each in bridge.parameters["bridges"]] == ["/a"]


def test_computers_find_each_other_by_their_addresses(tmp_path: Path) -> None:
    robot = of(
        tmp_path,
        HEAD.replace(
            "memory: 1 GiB", "memory: 1 GiB, address: 10.0.0.1:7447", 1
        ).replace("memory: 1 GiB}}", "memory: 1 GiB, address: 10.0.0.2}}")
        + SCAN
        + "ros2: {discovery: computers}\n",
    )
    assert ros2_environment(robot) == {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_STATIC_PEERS": "10.0.0.1;10.0.0.2",
    }


def test_a_wrong_address_is_said_where_nodes_need_it(refuse: Refuse) -> None:
    """The variables of ROS 2, which are made of the addresses, come after it."""
    text = HEAD.replace("memory: 1 GiB", "memory: 1 GiB, ▸address: 10.0.0.999", 1)
    text = text.replace("memory: 1 GiB}}", "memory: 1 GiB, address: 10.0.0.2}}")
    text += f"{SCAN}{DRIVE}ros2: {{discovery: computers, bridges: [{BRIDGE}]}}\n"
    refuse(text, "'10.0.0.999' is not a valid IPv4 address")
