from functools import partial

import pytest
from msgspec.structs import replace

from poise.estimate.profiles import ConnectorProfile, Distribution, HandlerProfile
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
)
from poise.session.profiling.figures import (
    MeasuredUsage,
    Observed,
    disagreeing,
    failures,
    how_full,
)
from poise.session.profiling.figures import figures as measured_figures
from poise.session.profiling.rig import EMPTY, ProfilingRig
from poise.wire.records.status_records import (
    AgentStatus,
    ComponentStatus,
    ConnectorStatus,
    ContainerStatus,
    Summary,
    TimerStatus,
)

NAMES = ("eye", "mind")
ROBOT = Robot(
    name="r",
    computers=(Computer(name="a", capacity={"cpu": 1.0, "memory": 1e9}),),
    architectures=(
        Architecture(
            name="see",
            function="seeing",
            components=tuple(ComponentEntry(name=name) for name in NAMES),
            connectors=(
                Connector(
                    between=(ConnectorEnd("eye", "x"), ConnectorEnd("mind", "x"))
                ),
            ),
        ),
    ),
)


def observed(eye: float, *, undone: float = 0.0, busy: float = 0.5) -> Observed:
    """Both in one container of 30 MB, which uses 4 % beyond them."""
    return Observed(
        measured=MeasuredUsage(
            cpu={
                "eye": Distribution(mean=eye, peak=2 * eye),
                "mind": Distribution(mean=0.2),
            },
            rest={"see": 0.04},
            members={"see": NAMES},
            memory={"see": 30e6},
            agents={"a": 0.01},
            busy={"a": busy},
            connectors={"eye.x-mind.x": ConnectorProfile(messages=10.0)},
            undone={"eye": undone},
        ),
        statuses={},
    )


def apart() -> Observed:
    """Alone: eye 17 MB, mind 28 MB, an empty container 5 MB; messages of 500 B."""
    status = ContainerStatus(
        name="see.eye",
        pid=1,
        components=(ComponentStatus(name="eye", state="inactive", snapshot=123),),
    )
    return Observed(
        measured=MeasuredUsage(
            cpu={},
            rest={},
            members={"see.eye": ("eye",), "see.mind": ("mind",), "see.e": (EMPTY,)},
            memory={"see.eye": 17e6, "see.mind": 28e6, "see.e": 5e6},
            agents={},
            connectors={"eye.x-mind.x": ConnectorProfile(messages=9.0, size=500.0)},
            undone={},
        ),
        statuses={
            "a": AgentStatus(
                computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(status,)
            )
        },
    )


RIG = ProfilingRig(ROBOT, "a", {}, NAMES, 1.0)
figures = partial(
    measured_figures, ROBOT, RIG, versions=dict.fromkeys(NAMES, "v"), speed=1.0
)


def test_takes_the_run_in_the_middle() -> None:
    runs = [observed(0.104), observed(0.1), observed(0.102)]
    eye = figures(runs, apart()).components["eye"]
    assert eye.cpu.mean == 0.102
    assert eye.repeat == pytest.approx(0.004)
    assert eye.stable


def test_divides_what_the_container_used_beyond_its_components() -> None:
    found = figures([observed(0.1)], apart())
    assert [c.share for c in found.components.values()] == [0.02, 0.02]
    assert found.agent == 0.01


@pytest.mark.parametrize(
    ("eye", "mind", "shares"),
    [
        (0.03, 0.01, [0.03, 0.01]),  # each 0.02 and 0 beyond an empty one; 0.02 is left
        (0.09, 0.03, [0.032, 0.008]),  # 0.08 and 0.02: more than they used together
        (0.0, 0.03, [0.01, 0.03]),
    ],
)
def test_threads_of_a_components_own_are_its_part(
    eye: float, mind: float, shares: list[float]
) -> None:
    """An empty container uses 1 %, and both together 4 % beyond their components."""
    alone = apart()
    rest = {"see.eye": eye, "see.mind": mind, "see.e": 0.01}
    alone = replace(alone, measured=replace(alone.measured, rest=rest))
    found = figures([observed(0.1)], alone)
    assert [c.share for c in found.components.values()] == pytest.approx(shares)


def test_tells_memory_of_components_and_what_they_share() -> None:
    """Alone they add 12 and 23 MB to an empty container of 5 MB, together 25 MB.

    So 35 - 25 = 10 MB are libraries that both brought along: own 2 and 13 MB, and half
    of 5 + 10 MB each. In all that is the 30 MB of their container.
    """
    found = figures([observed(0.1)], apart()).components
    assert [found[n].memory for n in NAMES] == pytest.approx([2e6, 13e6])
    assert [found[n].base for n in NAMES] == pytest.approx([7.5e6, 7.5e6])


def test_rates_are_those_of_use_and_sizes_those_of_the_wire() -> None:
    found = figures([observed(0.1)], apart()).connectors
    assert found == {"eye.x-mind.x": ConnectorProfile(messages=10.0, size=500.0)}


def test_weighs_snapshots_and_counts_cpu_of_the_reference() -> None:
    slow = partial(figures, speed=0.5)
    eye = slow([observed(0.1)], apart()).components["eye"]
    assert (eye.state, eye.cpu.mean, eye.cpu.peak) == (123.0, 0.05, 0.1)
    assert eye.share == 0.01


@pytest.mark.parametrize(("deadline", "share"), [(0.1, 0.2), (None, None)])
def test_only_a_timer_with_a_deadline_misses_it(
    deadline: float | None, share: float | None
) -> None:
    tick = TimerStatus(
        name="tick",
        period=0.1,
        deadline=deadline,
        releases=10,
        missed=2 if deadline else 0,
        lateness=Summary(),
        duration=Summary(),
    )
    eye = ComponentStatus(name="eye", state="active", timers=(tick,))
    container = ContainerStatus(name="see", pid=1, components=(eye,))
    agent = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    run = replace(observed(0.1), working={"a": agent})
    found = figures([run], apart()).components["eye"]
    assert found.timers["tick"].missed == share


def test_means_that_lie_apart_are_not_stable() -> None:
    """More than 5 % and more than 0.01 cores."""
    assert disagreeing([observed(0.1), observed(0.109)], NAMES) == []
    assert disagreeing([observed(0.1), observed(0.12)], NAMES) == ["eye"]
    assert disagreeing([observed(0.5), observed(0.52)], NAMES) == []


def test_a_component_that_does_not_keep_up_is_not_stable() -> None:
    assert disagreeing([observed(0.1, undone=0.1)], NAMES) == ["eye"]


def test_a_computer_is_as_full_as_in_its_fullest_run() -> None:
    """A real one of half the speed is no fuller than its own cores are used."""
    runs = [observed(0.1, busy=0.7), observed(0.1, busy=0.6)]
    assert how_full(runs, RIG) == 0.7
    half = replace(ROBOT.computers[0], speed=0.5)
    emulated = replace(RIG, robot=replace(ROBOT, computers=(half,)))
    assert how_full(runs, emulated) == 1.4
    real = replace(ROBOT, computers=(replace(half, address="10.0.0.1"),))
    assert how_full(runs, replace(RIG, robot=real)) == 0.7
    assert how_full([apart()], RIG) == 0.0  # it cannot tell


def test_one_that_told_nothing_is_not_stable() -> None:
    assert disagreeing([observed(0.1)], ["ear"]) == ["ear"]


def test_a_connector_without_traffic_has_no_figures() -> None:
    quiet = observed(0.1)
    quiet = replace(
        quiet,
        measured=replace(
            quiet.measured, connectors={"eye.x-mind.x": ConnectorProfile()}
        ),
    )
    assert figures([quiet], quiet).connectors == {}


@pytest.mark.parametrize(("errors", "always"), [(2, set()), (5, {*NAMES})])
def test_calls_that_failed_are_told_and_nothing_is_known_if_all_did(
    errors: int, always: set[str]
) -> None:
    end = ConnectorStatus(
        name="eye.x-mind.x",
        kind="direct",
        end="both",
        ready=True,
        calls=5,
        errors=errors,
    )
    container = ContainerStatus(name="see", pid=1, connectors=(end,))
    status = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    run = replace(observed(0.1), working={"a": status})
    found = failures(ROBOT, run, NAMES)
    assert found.sentences == (f"eye.x-mind.x: {errors} of 5 calls failed",)
    assert found.always == always


def test_what_calls_take_is_their_connectors() -> None:
    """Alone, as they come from another container there."""
    taken = Summary(2, 0.01, 0.01, 0.02, 0.02)
    waited = Summary(1, 0.05, 0.04, 0.06, 0.06)  # one of two runs
    mind = ComponentStatus(
        name="mind",
        state="active",
        work={"eye.x-mind.x": taken, "tick": taken},
        waits={"eye.x-mind.x": waited},
    )
    container = ContainerStatus(name="see", pid=1, components=(mind,))
    agent = AgentStatus(
        computer="a", generation=1, uptime=1.0, cpu=0.0, containers=(container,)
    )
    run = replace(observed(0.1), working={"a": agent})
    found = figures([run], replace(apart(), working={"a": agent}))
    assert set(found.components["mind"].handlers) == {"tick"}
    assert found.connectors["eye.x-mind.x"].answering == HandlerProfile(
        mean=0.01, median=0.01, p99=0.02, waiting=0.5, wait=0.04, wait_p99=0.06
    )
