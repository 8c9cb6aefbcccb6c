"""The navigator in the simulated home, in virtual time and on one thread."""

from __future__ import annotations

from collections.abc import Callable

from poise.clock import Stamp
from poise.runtime.component.ports import Published
from tests.trot.alone import VirtualClock, alone
from trot import home
from trot.messages import Pose, Scan
from trot.navigator.localiser import Localiser
from trot.navigator.mapper import Mapper
from trot.navigator.motion_controller import MotionController
from trot.navigator.path_planner import PathPlanner
from trot.packets import unpack_command
from trot.world.simulation import STEP, Simulation


class LatePoses:
    """Tells poses as they were `delay` [s] ago."""

    def __init__(self, clock: VirtualClock, first: Pose, delay: float) -> None:
        self._clock = clock
        self._delay = delay
        self._poses = [first]

    def add(self, pose: Pose) -> None:
        self._poses.append(pose)

    def latest_pose(self) -> Pose:
        told = self._clock.now() - self._delay
        known = [pose for pose in self._poses if pose.stamp.at <= told]
        return known[-1] if known else self._poses[0]


class Wheels:
    """Takes commands in the place of the device, and hands them on `latency` later."""

    def __init__(self, clock: VirtualClock, simulation: Simulation) -> None:
        self._clock = clock
        self._simulation = simulation
        self._waiting: list[tuple[float, bytes]] = []
        self.latency = 0.06

    def send(self, packet: bytes) -> bool:
        self._waiting.append((self._clock.now() + self.latency, packet))
        return True

    def deliver(self) -> None:
        while self._waiting and self._waiting[0][0] <= self._clock.now():
            command = unpack_command(self._waiting.pop(0)[1])
            assert command is not None
            self._simulation.command(*command)


class Drive:
    """A drive from the start on.

    Parameters
    ----------
    delay
        How old [s] poses are when they are told.
    period
        The period of the motion controller's cycle [s].
    effort
        CPU time [s] of each of its cycles; 0 makes a drive repeatable.
    start
        x [m], y [m], heading [rad].
    """

    def __init__(
        self,
        *,
        delay: float = 0.0,
        period: float = 0.2,
        effort: float = 0.0,
        start: tuple[float, float, float] = home.START,
        seed: int = 0,
    ) -> None:
        self.clock = VirtualClock()
        self.simulation = Simulation(seed, start=start)
        localiser = alone(Localiser, {"start": start}, clock=self.clock).component
        mapper = alone(Mapper, clock=self.clock).component
        poses = LatePoses(self.clock, localiser.latest_pose(), delay)
        asked = {"poses": poses, "maps": mapper}
        planner = alone(PathPlanner, clock=self.clock, providers=asked).component
        self.controller = alone(
            MotionController, {"cpu": effort}, clock=self.clock, providers=asked
        )
        self.wheels = Wheels(self.clock, self.simulation)
        self.controller.component._wheels = self.wheels
        localiser.located = Published(mapper.located)
        planner.path = Published(self.controller.component.path)
        self.localiser, self._planner, self._poses = localiser, planner, poses
        self._period = period

    def run(self, seconds: float) -> None:
        """Drive until the goal is reached, for `seconds` [s] at most."""
        steps = 0
        while self.clock.time < seconds and not self.simulation.goal_reached:
            self.wheels.deliver()
            self.simulation.step()
            self.clock.time = self.simulation.now
            steps += 1
            self._due(steps, 0.1, 0, self._scan)
            self._due(steps, 0.5, 5, self._planner.plan)
            self._due(steps, self._period, 6, self.controller.component.cycle)

    def _scan(self) -> None:
        stamp, x, y, heading = self.simulation.odometry
        odometry = Pose(Stamp(stamp), x, y, heading)
        self.localiser.scan(Scan(Stamp(stamp), self.simulation.scan(), odometry))
        self._poses.add(self.localiser.latest_pose())

    @staticmethod
    def _due(step: int, period: float, phase: int, call: Callable[[], None]) -> None:
        if step > phase and (step - phase) % round(period / STEP) == 0:
            call()
