"""The whole robot in its simulated cell, in virtual time and on one thread."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from poise.model import load
from poise.runtime.component.implementation import find
from poise.runtime.component.ports import Published, timers_of
from sorter.world.__main__ import World
from sorter.world.scene import STEP
from tests.trot.alone import VirtualClock, alone

EXAMPLE = Path(__file__).parents[2] / "examples" / "sorter"
LESSER = {"small_detector", "quick_inspector"}


class Loop:
    """The components of the robot file, wired as it says; only detection takes time."""

    def __init__(
        self,
        folder: Path,
        seed: int = 0,
        without: Collection[str] = LESSER,
        detection_takes: float = 0.0,
    ) -> None:
        robot = load(EXAMPLE / "robot.yaml")
        self.clock, self.world = VirtualClock(), World(folder, seed)
        self.components: dict[str, Any] = {}
        self.done: list[bool] = []
        devices = {each.name: str(folder / each.path) for each in robot.devices}
        for each in robot.components():
            if each.name not in without:
                implementation = find(each.implementation, str(EXAMPLE))
                self.components[each.name] = alone(
                    implementation, each.parameters, clock=self.clock, devices=devices
                ).component
        inner = [each for one in robot.architectures for each in one.connectors]
        self._wire([*robot.connectors, *inner])
        self._takes = detection_takes
        self._detected: deque[tuple[float, Any]] = deque()
        if "detector" in self.components:
            self.components["detector"].detections = Published(self._detect)
        self._timers = [
            (timer.period, getattr(component, timer.name))
            for component in self.components.values()
            for timer in timers_of(type(component)).values()
        ]

    def _wire(self, connectors: Any) -> None:
        targets: dict[tuple[str, str], list[Callable[[Any], None]]] = defaultdict(list)
        for connector in connectors:
            (one, port), (other, its) = (
                (end.component, end.port) for end in connector.between
            )
            if {one, other} <= self.components.keys():
                if hasattr(type(self.components[other]), its):
                    handler = getattr(self.components[other], its)
                    targets[one, port].append(handler)
                else:
                    setattr(self.components[one], port, self.components[other])
        targets["grasp_planner", "done"].append(self.done.append)
        for (one, port), handlers in targets.items():

            def publish(message: object, handlers: list[Any] = handlers) -> None:
                for handler in handlers:
                    handler(message)

            setattr(self.components[one], port, Published(publish))

    def _detect(self, message: object) -> None:
        """Let the tracker have what is detected so long later."""
        self._detected.append((self.clock.now() + self._takes, message))
        self._deliver()

    def _deliver(self) -> None:
        while self._detected and self._detected[0][0] <= self.clock.now():
            self.components["tracker"].detections(self._detected.popleft()[1])

    def run(self, seconds: float) -> dict[str, Any]:
        """Run until the task is done, or this time has passed; say how it went."""
        steps = 0
        while self.clock.now() < seconds and not self.done:
            self.world.step(self.clock.now())
            self.clock.sleep(STEP)
            steps += 1
            self._deliver()
            for period, timer in self._timers:
                if steps % round(period / STEP) == 0:
                    timer()
        return self.world.result()

    def close(self) -> None:
        """Close the devices at both ends."""
        for component in self.components.values():
            component.cleanup()
        self.world.close()
