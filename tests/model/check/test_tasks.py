"""Tasks that cannot be done as they are written."""

from collections.abc import Callable

import pytest

from poise.errors import FileProblem

Find = Callable[[str], tuple[FileProblem, ...]]
Refuse = Callable[..., None]

ROBOT = """
robot: r
computers:
  main: {cpu: 2, memory: 1 GiB}
devices:
  arm: {computer: main, exclusive: true}
  camera: {computer: main}
architectures:
  grasp:
    function: grasping
    components:
      gripper:
        devices: [arm]
        ports: {done: {publishes: "builtins:bool"}, go: {subscribes: "builtins:bool"}}
  push:
    function: pushing
    components:
      pusher: {devices: [arm]}
  kick:
    function: kicking
    components:
      kicker: {devices: [arm]}
  kick_with_foot:
    function: kicking
    components:
      foot: {}
  see:
    function: seeing
    components: {eyes: {devices: [camera]}}
  talk:
    function: talking
    exclusive: true
    components: {mouth: {}}
chains: {sight: {through: [eyes, mouth], deadline: 1 s}}
connectors: [{between: [eyes, mouth]}]
tasks:
  other: {actions: [{name: look, functions: [seeing]}]}
  t:
    actions:
"""


def task(*steps: str) -> str:
    return ROBOT + "".join(f"      - {step}\n" for step in steps)


def both(first: str, second: str) -> str:
    """Return two actions at once, the second with the mark."""
    one, two = (f"name: a, functions: [{first}]", f"name: b, functions: [{second}]")
    return f"parallel: [{{{one}}}, ▸{{{two}}}]"


RIGHT = [
    "{name: a, functions: [grasping], ends: gripper.done, limit: 30 s}",
    "{name: b, functions: [], on failure: {retry: 2}}",
    "{name: c, functions: [], on failure: give up}",
    "{name: d, functions: [], on failure: {retry: 2, then: {name: e, functions: []}}}",
    "{name: f, functions: [seeing], until: late == 0 and used < 50%}",
    "{name: g, functions: [seeing], until: {component: eyes, when: cpu < 10%}}",
    "{name: h, functions: [seeing], until: {chain: sight, when: age < 100 ms}}",
    "{repeat: [{name: i, functions: []}], times: 3, until: 'late > 0'}",
    "parallel: [{name: j, functions: [seeing]}, {name: k, functions: [seeing]}]",
    "task: other",
    "choice: [{task: other}, {name: l, functions: [talking]}]",
    "parallel: [{name: m, functions: [grasping]}, {name: n, functions: [kicking]}]",
]


def test_a_robot_without_chains_has_no_chain_to_wait_for(refuse: Refuse) -> None:
    until = "{▸chain: sight, when: late}"
    text = task(f"{{name: a, functions: [], until: {until}}}")
    refuse(text.replace("chains:", "# chains:"), "no chain 'sight'", "chains: none")


@pytest.mark.parametrize("step", RIGHT)
def test_accepts(find: Find, step: str) -> None:
    assert find(task(step)) == ()


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("{name: a, functions: [▸seing]}", ["no function 'seing'", "'seeing'?"]),
        (
            "{name: a, functions: [seeing, ▸seeing]}",
            ["'seeing' is listed twice"],
        ),
        ("▸jump: [seeing]", ["has 'jump'", "'name', 'task'", "'parallel'"]),
        (
            "▸paralel: [{name: a, functions: []}]",
            ["has 'paralel' (did you mean 'parallel'?)"],
        ),
        (
            "▸{name: a, functions: [], parallel: []}",
            ["has 'name' and 'parallel'; it takes one of"],
        ),
        ("▸look", ["must be a mapping with one of 'name'", "not 'look'"]),
        ("{▸parallel: [{task: other}]}", ["at least 2"]),
        ("{repeat: [{task: other}], ▸times: 0}", ["must be at least 1"]),
        ("{name: a, functions: [], ▸limit: 0 s}", ["above 0"]),
        ("{▸task: othr}", ["no task 'othr'", "did you mean 'other'?"]),
        ("{▸task: t}", ["a task cannot be a step of itself: t -> t"]),
        (
            "sequence: [{name: a, functions: []}, {▸name: a, functions: []}]",
            ["an action 'a' in this task already"],
        ),
        (
            "{name: a, functions: [grasping], ▸ends: griper.done}",
            ["no component 'griper'", "'gripper'?"],
        ),
        (
            "{name: a, functions: [grasping], ▸ends: gripper}",
            ["name the port of 'gripper' too"],
        ),
        (
            "{name: a, functions: [grasping], ▸ends: gripper.dne}",
            ["no port 'dne'", "'done'"],
        ),
        (
            "{name: a, functions: [grasping], ▸ends: gripper.go}",
            ["'gripper.go' subscribes", "publishes bool"],
        ),
        (
            "{name: a, functions: [seeing], ▸ends: gripper.done}",
            ["belongs to the function 'grasping'", "add it to `functions`"],
        ),
        (
            "{name: a, functions: [kicking], ▸ends: kicker.done}",
            ["'kick_with_foot' may provide 'kicking' without it", "use `until`"],
        ),
        ("{name: a, functions: [], ▸until: late >}", ["is not a condition"]),
        ("{name: a, functions: [], ▸until: used > 5 s}", ["cannot be compared"]),
        (
            "{name: a, functions: [], until: {▸component: eye, when: cpu > 1}}",
            ["no component 'eye'", "did you mean 'eyes'?"],
        ),
        (
            "{name: a, functions: [], until: {▸link: main-vison, when: cut}}",
            ["no link 'main-vison'"],
        ),
        (
            "{name: a, functions: [], until: {▸timer: eye.look, when: late}}",
            ["no component 'eye'", "did you mean 'eyes'?"],
        ),
        (
            "{name: a, functions: [], until: {▸timer: eyes, when: late}}",
            ["name the timer of 'eyes' too, as in eyes.update"],
        ),
        (
            "{name: a, functions: [], until: {component: eyes, ▸when: age > 1 s}}",
            ["no value 'age'"],
        ),
        (
            "{name: a, functions: [], ▸until: {component: eyes, chain: c, when: x}}",
            ["one subject, not about 'component' and 'chain'"],
        ),
        (
            "{name: a, functions: [], ▸on failure: give in}",
            ["'give in' is not 'give up'"],
        ),
        (
            "{name: a, functions: [], on failure: {▸retry: 0}}",
            ["must be at least 1"],
        ),
        (
            "{name: a, functions: [], on failure: {name: b, functions: [▸f]}}",
            ["no function 'f'"],
        ),
        (
            "{name: a, functions: [], on failure: {retry: 1, then: {▸task: x}}}",
            ["no task 'x'"],
        ),
        (
            both("grasping", "pushing"),
            ["'grasping' of 'a' and 'pushing' of 'b'", "device 'arm'", "exclusive"],
        ),
        (
            "▸{name: a, functions: [grasping, pushing]}",
            ["'grasping' of 'a' and 'pushing' of 'a' would use the device 'arm'"],
        ),
        (
            both("talking", "talking"),
            ["'a' and 'b' would use the function 'talking'", "exclusive"],
        ),
    ],
)
def test_refuses(refuse: Refuse, step: str, words: list[str]) -> None:
    refuse(task(step), *words)


@pytest.mark.parametrize(
    ("needs", "words"),
    [
        ("[▸seing]", ["'t' uses no function 'seing'", "mean 'seeing'?"]),
        ("[seeing, ▸kicking]", ["no function 'kicking'", "it uses 'seeing'"]),
    ],
)
def test_refuses_needs_that_no_action_uses(
    refuse: Refuse, needs: str, words: list[str]
) -> None:
    step = "{name: a, functions: [seeing]}"
    refuse(f"{task(step)}    needs: {needs}\n", *words)


def test_takes_needs_of_the_tasks_that_a_task_names(find: Find) -> None:
    assert not find(f"{task('task: other')}    needs: [seeing]\n")


def test_refuses_tasks_that_name_each_other(find: Find) -> None:
    text = task("task: other").replace(
        "[{name: look, functions: [seeing]}]", "[{task: t}]"
    )
    first, second = find(text)
    assert "other -> t -> other" in first.message
    assert "t -> other -> t" in second.message


def test_refuses_more_phases_than_can_be_planned(find: Find) -> None:
    branches = ", ".join(
        "{sequence: ["
        + ", ".join(f"{{name: {x}{i}, functions: []}}" for i in range(11))
        + "]}"
        for x in "ab"
    )
    (problem,) = find(task(f"parallel: [{branches}]"))
    assert "more than 100 phases" in problem.message
