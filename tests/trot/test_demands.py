"""What the robot file says of each component is what it does."""

from __future__ import annotations

import importlib
import time
import tracemalloc
from collections.abc import Callable, Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from poise.clock import Stamp, SystemClock
from poise.estimate.demands import with_profile
from poise.estimate.profile import file as profile_file
from poise.model import load
from poise.model import robot as model
from poise.runtime.component.component import Component
from poise.runtime.component.ports import methods_of, ports_of, timers_of
from poise.units import BYTES, parse
from poise.wire.codec import codec
from tests.trot.alone import Alone, alone
from trot import home, messages
from trot.laser_model import BEAMS
from trot.navigator import grid
from trot.navigator.mapper import Mapper
from trot.packets import (
    MICROPHONES,
    SOUND_SAMPLES,
    pack_odometry,
    pack_ranges,
    pack_sound,
)
from trot.world.simulation import Simulation
from trot.world.sound import Sound

pytestmark = pytest.mark.slow

FILE = FilePath(__file__).parents[2] / "examples" / "trot" / "robot.yaml"
HEAD = 32
"""Of a frame [bytes]."""
BATCHES = 3
PROFILE = profile_file.read(FILE.with_name("profile.yaml"))
ROBOT = with_profile(load(FILE), PROFILE)
COMPONENTS = {component.name: component for component in ROBOT.components()}
CONNECTORS = [
    *ROBOT.connectors,
    *(c for architecture in ROBOT.architectures for c in architecture.connectors),
]

POSE = messages.Pose(Stamp(0.0), *home.START)
RANGES = Simulation().scan()
PATH = np.linspace(home.START[:2], home.GOAL, 40).astype(np.float32)
PICTURE = np.zeros((120, 160, 3), np.uint8)
JOINTS = np.array([0, 0.6, 0, -0.6, 0, 0], np.float32)
NUMBERS = list(range(20))

MESSAGES: dict[type, Any] = {
    messages.Scan: messages.Scan(Stamp(0.0), RANGES, POSE),
    messages.LocatedScan: messages.LocatedScan(POSE, RANGES),
    messages.Path: messages.Path(Stamp(0.0), PATH),
    messages.AudioBlock: messages.AudioBlock(0.0, Sound().block()),
    messages.Bearing: messages.Bearing(0.0, 0.5, 1.0),
    messages.Activity: messages.Activity(0.0, 1.0),
    messages.Speech: messages.Speech(0.0, np.full((20, 20), 9, np.float32)),
    messages.Attention: messages.Attention(0.0, 0.5, 1.0),
    messages.Utterance: messages.Utterance(0.0, "television", 0.5),
    messages.Sentence: messages.Sentence(0.0, "I am on my way to the kitchen."),
    messages.Emotion: messages.Emotion(0.0, 0.3, 0.4),
    messages.Gesture: messages.Gesture(0.0, 0.4, 0.0, 0.1),
    messages.Image: messages.Image(0.0, PICTURE),
    messages.Joints: messages.Joints(0.0, JOINTS),
    messages.Trajectory: messages.Trajectory(0.0, np.zeros((50, 6), np.float32)),
    messages.Wish: messages.Wish(0.0, 3),
}
"""One message of every type, of the usual size."""

CALLS: dict[str, tuple[tuple[Any, ...], Any]] = {
    "latest_pose": ((), POSE),
    "latest_map": ((), alone(Mapper).component.latest_map()),
    "solve": ((np.array([0.4, 0, 0.1], np.float32), JOINTS), JOINTS),
    "clearance": ((np.zeros((10, 6), np.float32),), 0.3),
    "search": (
        (3,),
        [messages.Programme(n, f"Programme {n}", 3, 5e5) for n in NUMBERS],
    ),
    "weights": ((), np.full(16, 1 / 16, np.float32)),
    "predict": ((NUMBERS,), [0.5] * 20),
}
"""Arguments and answer of every call, of the usual size."""


class Provider:
    """Answers every call at once."""

    def __getattr__(self, method: str) -> Callable[..., Any]:
        return lambda *_: CALLS[method][1]


class PlayedDevice:
    """Plays a device: gives the same packet at every read."""

    def __init__(self, packet: bytes) -> None:
        self.packet = packet

    def receive(self, timeout: float = 0.0) -> list[bytes]:
        del timeout
        return [self.packet]

    def send(self, packet: bytes) -> bool:
        return len(packet) > 0


def devices() -> Mapping[str, PlayedDevice]:
    return {
        "_laser": PlayedDevice(pack_ranges(0.0, RANGES)),
        "_wheels": PlayedDevice(pack_odometry((0.0, *home.START))),
        "_microphones": PlayedDevice(pack_sound(0.0, Sound().block())),
        "_speakers": PlayedDevice(b""),
    }


def implementation_of(component: model.ComponentEntry) -> type[Component]:
    module, name = component.implementation.split(":")
    found: type[Component] = getattr(importlib.import_module(module), name)
    return found


def started(component: model.ComponentEntry) -> Alone:
    implementation = implementation_of(component)
    ports = ports_of(implementation).values()
    required = {port.name: Provider() for port in ports if port.kind == "requires"}
    built = alone(
        implementation, component.parameters, clock=SystemClock(), providers=required
    )
    for attribute, device in devices().items():
        if hasattr(built.component, attribute):
            setattr(built.component, attribute, device)
    return built


def events(component: model.ComponentEntry, built: Any) -> list[tuple[float, Any]]:
    """Return what happens to a component, and how often [1/s]; messages come first."""
    found: list[tuple[float, Any]] = []
    ports = ports_of(type(built))
    for connector in CONNECTORS:
        end = connector.between[1]
        if end.component != component.name:
            continue
        port = ports[end.port]
        if port.kind == "subscribes":
            handler, message = getattr(built, end.port), MESSAGES[port.type]
            found.append((connector.rate, lambda h=handler, m=message: h(m)))
        for method in methods_of(port.type) if port.kind == "provides" else ():
            call, arguments = getattr(built, method), CALLS[method][0]
            found.append((connector.rate, lambda c=call, a=arguments: c(*a)))
    timers = timers_of(type(built)).values()
    return found + [(1 / t.period, getattr(built, t.name)) for t in timers]


def cpu_time(call: Callable[[], object]) -> float:
    """Return the CPU time of a call [s]: the least of the means of several batches.

    The first call, which warms up, is not in. Of short calls a batch has many, for each
    varies by a third.
    """
    call()
    return min(mean_cpu_time(call) for _ in range(BATCHES))


def mean_cpu_time(call: Callable[[], object]) -> float:
    before = time.thread_time()
    used, repeats = 0.0, 0
    while repeats < 3 or (used < 0.03 and repeats < 100):
        call()
        repeats += 1
        used = time.thread_time() - before
    return used / repeats


@pytest.mark.parametrize("name", COMPONENTS)
def test_uses_the_cpu_that_was_profiled(name: str) -> None:
    """To a half, or to what the container's threads use beside the component's code.

    Other work on the same core makes all code slower, never quicker: the least counts.
    And another computer than the one where it was profiled is quicker, or slower.
    """
    component = COMPONENTS[name]
    built = started(component).component
    used = sum(rate * cpu_time(call) for rate, call in events(component, built))
    profiled = PROFILE.components[name].cpu.mean
    assert used == pytest.approx(profiled, rel=0.5, abs=0.006)


@pytest.mark.parametrize("name", COMPONENTS)
def test_uses_the_memory_that_it_declares(name: str) -> None:
    """Beyond its working set: the code, its libraries, its part of the container."""
    component = COMPONENTS[name]
    tracemalloc.start()
    try:
        built = started(component).component
        for _, call in events(component, built):
            call()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    declared = component.demand["memory"]
    working_set = parse(component.parameters["working_set"], BYTES)
    assert working_set <= peak <= declared <= working_set + 16 * 2**20


@pytest.mark.parametrize("connector", CONNECTORS, ids=str)
def test_messages_are_as_large_as_declared(connector: model.Connector) -> None:
    """With frames' heads, to a half of the larger: lists are not as long as here."""
    end = connector.between[1]
    port = ports_of(implementation_of(COMPONENTS[end.component]))[end.port]
    if port.kind == "subscribes":
        size = HEAD + encoded(MESSAGES[port.type])
    else:
        (method,) = methods_of(port.type)
        arguments, answer = CALLS[method]
        size = 2 * HEAD + encoded(answer) + sum(map(encoded, arguments))
    margin = max(60.0, 0.5 * max(size, connector.message))
    assert size == pytest.approx(connector.message, abs=margin)


def encoded(value: Any) -> int:
    body, buffers = codec(Any).encode(value)
    return len(body) + sum(buffer.nbytes for buffer in buffers)


@pytest.mark.parametrize("name", COMPONENTS)
def test_states_are_as_large_as_declared(name: str) -> None:
    component = COMPONENTS[name]
    built = started(component).component
    for _, call in events(component, built):
        call()
    state = built.snapshot()
    size = 0 if state is None else encoded(state)
    assert size == pytest.approx(component.state, rel=0.33, abs=100)


def test_has_the_components_of_the_case_study() -> None:
    counts = [len(architecture.components) for architecture in ROBOT.architectures]
    assert counts == [5, 4, 4, 7, 4]
    assert len(COMPONENTS) == 24


def test_overloads_one_computer_and_fits_on_two() -> None:
    """A computer is half a core: 0.7 cores are 140 % of one, and 70 % of two."""
    mean = {name: PROFILE.components[name].cpu.mean for name in COMPONENTS}
    navigator = [c.name for c in ROBOT.architectures[0].components]
    assert sum(mean[name] for name in navigator) == pytest.approx(0.175, rel=0.1)
    assert sum(mean.values()) == pytest.approx(0.7, rel=0.1)


def test_is_told_to_drive_there_and_back() -> None:
    goals = COMPONENTS["path_planner"].parameters["goals"]
    assert tuple(goals[0]) == home.GOAL
    assert tuple(goals[1]) == home.START[:2]


def test_samples_have_the_shapes_of_the_real_thing() -> None:
    assert RANGES.shape == (BEAMS,)
    assert MESSAGES[messages.AudioBlock].samples.shape == (MICROPHONES, SOUND_SAMPLES)
    assert CALLS["latest_map"][1].cells.shape == (grid.SIZE, grid.SIZE)
