import pytest
from msgspec.structs import replace

from poise.errors import UsageError
from poise.manage.deploy.deployment_layout import DeploymentLayout
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    DeclaredPort,
    Device,
    Robot,
    Simulator,
    Workload,
)
from poise.session.profiling.calibrate import yardsticks
from poise.session.profiling.rig import EMPTY, OTHERS, ProfilingRig, rig_of


def architecture(name: str, *components: ComponentEntry) -> Architecture:
    return Architecture(name=name, function=name, components=components)


def computer(name: str, address: str | None = None) -> Computer:
    return Computer(
        name=name, capacity={"cpu": 1.0, "memory": 1e9}, speed=0.5, address=address
    )


ASKS = DeclaredPort(name="map", kind="requires", type="p:Map")
ROBOT = Robot(
    name="r",
    computers=(computer("main"), computer("vision")),
    devices=(Device(name="laser", computer="main"),),
    architectures=(
        architecture("see", ComponentEntry(name="eye", devices=("laser",))),
        architecture("think", ComponentEntry(name="mind", ports=(ASKS,))),
        architecture("remember", ComponentEntry(name="map")),
        architecture("speak", ComponentEntry(name="mouth")),
    ),
    connectors=(
        Connector(
            between=(ConnectorEnd("eye", "image"), ConnectorEnd("mind", "image"))
        ),
        Connector(between=(ConnectorEnd("mind", "map"), ConnectorEnd("map", "map"))),
        Connector(
            between=(ConnectorEnd("mind", "words"), ConnectorEnd("mouth", "words"))
        ),
    ),
    simulator=Simulator(command=("world",)),
    workload=Workload(command=("work",)),
)


def fed(rig: ProfilingRig) -> tuple[str, ...]:
    """Return the architectures that feed the one that is measured."""
    return tuple(each.name for each in rig.robot.architectures[1:])


def test_feeds_from_who_publishes_and_who_is_called() -> None:
    """The mouth only listens to the mind: it is not needed."""
    rig = rig_of(ROBOT, "think", "vision", apart=False)
    assert fed(rig) == ("see", "remember")
    assert rig.measured == ("mind",)
    assert rig.placement == {"mind": "vision", "eye": OTHERS, "map": OTHERS}


@pytest.mark.parametrize("name", [a.name for a in ROBOT.architectures])
def test_a_stand_can_be_deployed(name: str) -> None:
    """It has no connector to a component that is not there."""
    rig = rig_of(ROBOT, name, "main", apart=False)
    there = {component.name for component in rig.robot.components()}
    ends = {e.component for c in rig.robot.all_connectors() for e in c.between}
    assert ends <= there == set(rig.placement)
    joined = DeploymentLayout(rig.robot, "folder").connectors(there)
    assert joined == list(rig.robot.all_connectors())


def test_feeds_from_who_feeds_the_feeders() -> None:
    assert fed(rig_of(ROBOT, "speak", "main", apart=False)) == (
        "see",
        "think",
        "remember",
    )


def test_others_are_as_large_as_all_together() -> None:
    rig = rig_of(ROBOT, "see", "main", apart=False)
    robot = rig.robot
    here, others = robot.computers
    assert here.capacity["memory"] == ROBOT.computer("main").capacity["memory"]
    assert here.total("cpu") == 1.0  # whole cores
    assert rig.promised == 0.5
    assert others.capacity["cpu"] * others.speed == 1.0
    assert robot.simulator == Simulator(command=("work",))


def test_apart_each_has_a_container_and_one_is_empty() -> None:
    rig = rig_of(ROBOT, "see", "main", apart=True)
    components = rig.robot.architectures[0].components
    assert [c.name for c in components] == ["eye", EMPTY]
    assert all(c.isolated for c in components)
    assert rig.measured == ("eye",)


def test_real_devices_hold_their_components() -> None:
    real = replace(
        ROBOT, computers=(computer("main", "10.0.0.1"), computer("vision", "10.0.0.2"))
    )
    rig = rig_of(real, "think", "vision", apart=False)
    assert rig.placement == {"mind": "vision", "eye": "main", "map": "main"}
    assert rig.robot.computers == real.computers


def test_names_what_there_is() -> None:
    with pytest.raises(UsageError, match="--on arm: the robot's computers are main, v"):
        rig_of(ROBOT, "see", "arm", apart=False)


def test_only_one_alternative_runs_and_the_measured_one_is_preferred() -> None:
    """Two provide `see`; messages reach neither if both run."""
    better = replace(architecture("look", ComponentEntry(name="eyes")), function="see")
    worse = replace(ROBOT.architectures[0], quality=0.5)
    robot = replace(
        ROBOT,
        architectures=(worse, *ROBOT.architectures[1:], better),
        connectors=(
            *ROBOT.connectors,
            Connector(
                between=(ConnectorEnd("eyes", "image"), ConnectorEnd("mind", "image"))
            ),
            Connector(
                between=(ConnectorEnd("mouth", "said"), ConnectorEnd("eyes", "said"))
            ),
        ),
    )
    assert fed(rig_of(robot, "think", "main", apart=False)) == (
        "remember",
        "speak",
        "look",
    )
    # The eyes need the mouth, that needs the mind, and that needs eyes: these.
    assert fed(rig_of(robot, "look", "main", apart=False)) == (
        "think",
        "remember",
        "speak",
    )


def test_a_witness_holds_no_component() -> None:
    """It comes first, is real, and is as large as any."""
    witness = replace(computer("router", "10.0.0.3"), witness=True)
    real = [computer("main", "10.0.0.1"), computer("vision", "10.0.0.2")]
    robot = replace(ROBOT, computers=(witness, *real), simulator=None, workload=None)
    rig = rig_of(robot, "think", "main", apart=False)
    assert {*rig.placement.values()} == {"main", "vision"}
    with pytest.raises(UsageError, match="--on router: the robot's computers are main"):
        rig_of(robot, "think", "router", apart=False)
    plain = [replace(c, address=None) for c in (witness, *real)]
    emulated = rig_of(
        replace(robot, computers=tuple(plain)), "think", "main", apart=False
    )
    assert emulated.robot.computer(OTHERS).total("cpu") == 2 * 0.5
    assert {*yardsticks(robot)[1].values()} == {"main", "vision"}
