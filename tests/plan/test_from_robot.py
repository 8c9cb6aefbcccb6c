"""From a robot to a problem: pins, devices, links and present placement."""

import pytest
from msgspec.structs import replace

from poise import plan
from poise.errors import RobotError, UsageError
from poise.model.robot import (
    Action,
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Device,
    Link,
    Robot,
    Task,
)
from poise.plan.problem.items import Item


@pytest.fixture
def robot() -> Robot:
    """Return a small robot: a camera pipeline, a motor loop, and an idle talker."""
    vision = Architecture(
        name="vision",
        function="see",
        home="main",
        components=(
            ComponentEntry(name="grabber", demand={"cpu": 0.2}, devices=("camera",)),
            ComponentEntry(name="finder", demand={"cpu": 0.5}, state=2e6),
        ),
        connectors=(
            Connector(
                between=(ConnectorEnd("grabber"), ConnectorEnd("finder")),
                message=1e6,
                rate=10.0,
            ),
        ),
    )
    motor = Architecture(
        name="motor",
        function="move",
        layer="reactive",
        home="main",
        components=(ComponentEntry(name="wheels", demand={"cpu": 0.1}),),
    )
    talk = Architecture(
        name="talk",
        function="speak",
        home="main",
        components=(ComponentEntry(name="voice", demand={"cpu": 0.1}, movable=False),),
    )
    return Robot(
        name="small",
        computers=(
            Computer(name="main", capacity={"cpu": 1.0}),
            Computer(name="eye", capacity={"cpu": 1.0}),
        ),
        devices=(Device(name="camera", computer="eye"),),
        links=(Link(between=("main", "eye"), bandwidth=5e6, distance=3.0),),
        architectures=(vision, motor, talk),
        tasks=(Task(name="fetch", actions=(Action(name="go", functions=("move",)),)),),
    )


def test_a_component_goes_where_its_device_is(robot: Robot) -> None:
    assert plan.solve(plan.problem_of(robot)).placement["grabber"] == "eye"


def test_only_the_sequencing_layer_moves(robot: Robot) -> None:
    wheels = plan.problem_of(robot, "fetch").components[0]
    assert wheels.only == ("main",)
    assert "reactive" in wheels.why


def test_a_task_brings_the_architectures_of_its_functions(robot: Robot) -> None:
    assert [c.name for c in plan.problem_of(robot, "fetch").components] == ["wheels"]


def test_static_puts_all_at_home_but_what_hangs_on_a_device(robot: Robot) -> None:
    problem = plan.problem_of(robot)
    assert plan.static(robot, problem) == {
        "grabber": "eye",
        "finder": "main",
        "wheels": "main",
        "voice": "main",
    }


def test_traffic_beyond_a_links_bandwidth_is_refused(robot: Robot) -> None:
    """The grabber sends 10 MB/s, the link carries 5 MB/s: both stay on the eye."""
    problem = plan.problem_of(robot)
    assert plan.solve(problem).placement["finder"] == "eye"
    apart = plan.evaluate(problem, plan.static(robot, problem))
    assert "link between main and eye: needs 10 MB/s, has 5 MB/s" in apart.reason


def test_a_link_that_is_too_narrow_is_told_with_its_units(robot: Robot) -> None:
    problem = plan.problem_of(robot)
    apart = tuple(
        replace(c, only=("main",)) if c.name == "finder" else c
        for c in problem.components
    )
    reason = plan.solve(replace(problem, components=apart)).reason
    assert "link main - eye carries 5 MB/s" in reason
    assert (
        "It would fit with 5 MB/s more bandwidth on main - eye (5 MB/s now)" in reason
    )


def test_link_distance_reaches_the_objective(robot: Robot) -> None:
    problem = plan.problem_of(robot)
    placement = {"grabber": "eye", "finder": "main", "wheels": "main", "voice": "main"}
    objective = plan.evaluate(problem, placement).objective
    near = replace(problem, links=(replace(problem.links[0], distance=1.0),))
    closer = plan.evaluate(near, placement).objective
    assert objective is not None
    assert closer is not None
    assert objective.communication == pytest.approx(3 * closer.communication)


def test_a_component_that_may_not_be_moved_stays_where_it_runs(robot: Robot) -> None:
    problem = plan.problem_of(robot, functions=("speak",), present={"voice": "eye"})
    assert problem.components[0].only == ("eye",)


def test_a_move_costs_more_with_more_state(robot: Robot) -> None:
    present = {"grabber": "eye", "finder": "eye"}
    problem = plan.problem_of(robot, functions=("see",), present=present, move=0.5)
    assert [c.move_cost for c in problem.components] == [0.5, 1.5]


def test_a_computer_that_is_gone_is_no_present_place(robot: Robot) -> None:
    problem = plan.problem_of(robot, functions=("speak",), present={"voice": "gone"})
    assert problem.components[0].only == ()


def test_of_computers_that_are_gone_nothing_is_expected(robot: Robot) -> None:
    """Else no decision could be taken while one that a component may use is lost."""
    voice = ComponentEntry(name="voice", only=("main", "eye"))
    speak = Architecture(name="speak", function="speak", components=(voice,))
    left = robot.on(c for c in robot.computers if c.name != "eye")
    problem = plan.problem_of(replace(left, architectures=(speak,)))
    assert problem.components[0].only == ("main",)
    assert problem.components[0].why == "only main or eye; eye not available"
    nowhere = replace(speak, components=(replace(voice, only=("eye",)),))
    with pytest.raises(RobotError, match="can run nowhere: only eye; eye not availab"):
        plan.problem_of(replace(left, architectures=(nowhere,)))
    other = replace(speak, name="whisper", components=(ComponentEntry(name="breath"),))
    problem = plan.problem_of(replace(left, architectures=(nowhere, other)))
    assert [bundle.name for bundle in problem.architectures] == ["whisper"]
    assert [component.name for component in problem.components] == ["breath"]


def test_says_which_pins_contradict(robot: Robot) -> None:
    devices = (*robot.devices, Device(name="arm", computer="main"))
    both = ComponentEntry(name="hand", devices=("camera", "arm"))
    torn = Architecture(name="grasp", function="grasp", components=(both,))
    with pytest.raises(RobotError, match="'hand' can run nowhere") as caught:
        plan.problem_of(replace(robot, devices=devices, architectures=(torn,)))
    assert "camera is on eye" in str(caught.value)
    assert "arm is on main" in str(caught.value)


def test_a_device_that_the_robot_lacks_is_nowhere(robot: Robot) -> None:
    """A robot that comes from no file may name one."""
    with pytest.raises(RobotError, match="nowhere: the robot has no device camera"):
        plan.problem_of(replace(robot, devices=()))


def test_says_which_task_or_function_is_unknown(robot: Robot) -> None:
    with pytest.raises(UsageError, match=r"no task 'dance' \(its tasks: fetch\)"):
        plan.problem_of(robot, "dance")
    with pytest.raises(RobotError, match="'dance'"):
        plan.problem_of(robot, functions=("dance",))


def arms(*, exclusive: bool) -> Robot:
    """Return a robot whose functions both need the arm; pushing also goes without."""

    def architecture(name: str, function: str, *devices: str) -> Architecture:
        component = ComponentEntry(name=f"{name}er", devices=devices)
        return Architecture(name=name, function=function, components=(component,))

    return Robot(
        name="arms",
        computers=(Computer(name="main", capacity={"cpu": 1.0}),),
        devices=(Device(name="arm", computer="main", exclusive=exclusive),),
        architectures=(
            architecture("grasp", "grasp", "arm"),
            architecture("push", "push", "arm"),
            replace(architecture("kick", "push"), quality=0.5),
        ),
    )


def test_an_exclusive_device_serves_one_architecture() -> None:
    both = plan.problem_of(arms(exclusive=True), functions=["grasp", "push"])
    assert plan.solve(both).architectures == {"push": "kick"}
    shared = plan.problem_of(arms(exclusive=False), functions=["grasp", "push"])
    assert plan.solve(shared).architectures == {"push": "push"}


def test_says_which_exclusive_device_is_in_the_way() -> None:
    robot = arms(exclusive=True)
    robot = replace(robot, architectures=robot.architectures[:2])
    problem = plan.problem_of(robot)
    assert plan.solve(problem).reason == (
        "grasper, pusher use device arm, which is exclusive. It would fit with grasper "
        "and pusher running one after the other"
    )
    needy = (replace(c, demand={"cpu": 0.8}) for c in problem.components)
    large = replace(problem, components=tuple(needy))
    assert plan.solve(large).reason.endswith(
        "It would fit with grasper and pusher running one after the other"
    )
    lighter = Item(name="lighter", demand={"cpu": 0.8})  # runs beside the pusher
    three = replace(
        large,
        components=(*large.components, lighter),
        exclusive={**large.exclusive, "lamp": ("lighter", "grasper")},
    )
    assert "It would fit with 0.6 more cpu on main" in plan.solve(three).reason
    static = plan.evaluate(problem, plan.static(robot, problem))
    assert static.reason == "grasper and pusher use device arm, which is exclusive"
    assert len(plan.solve(problem, fewer=True).placement) == 1
    crowd = (Item(name=f"c{i}") for i in range(100))
    many = replace(problem, components=(*problem.components, *crowd))
    assert "device arm, which is exclusive" in plan.solve(many).reason
