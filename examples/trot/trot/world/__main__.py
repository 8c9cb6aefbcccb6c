"""The simulated world as a process: ``POISE_RUN=/tmp/run python -m trot.world``.

It serves the devices' sockets in the folder POISE_RUN, says ``ready``, and runs until
SIGTERM comes, or its standard input ends when that is a pipe (so that it does not
outlive who holds the other end). ``--seed 3`` is another world. The last line it prints
is a JSON object that says how it went.
"""

from __future__ import annotations

import json
import os
import select
import signal
import stat
import sys
import time
from pathlib import Path
from typing import Any

from trot import eye_model, laser_model
from trot.packets import (
    DEVICES,
    SOUND_PERIOD,
    pack_arm,
    pack_odometry,
    pack_picture,
    pack_ranges,
    pack_sound,
    pack_watched,
    unpack_angle,
    unpack_arm,
    unpack_command,
    unpack_screen,
)
from trot.world import sound, television
from trot.world.camera import Camera
from trot.world.drive import Drive
from trot.world.errands import Errands, tasks
from trot.world.functions import criteria, working
from trot.world.head import Head
from trot.world.outlet import Outlet
from trot.world.person import Person
from trot.world.simulation import STEP, Simulation
from trot.world.view import View
from trot.world.walk import Walk

MOST_BEHIND = 0.1
"""[s] A world further behind the clock than this lets the rest of the time go."""

FOLLOWS = "I follow"
"""When the robot says this, the person leads it to the kitchen."""

CAMERA_PERIOD = 0.1
"""[s] from picture to picture."""


class World:
    """The simulation, and the sockets through which the robot meets it.

    Parameters
    ----------
    folder
        For the sockets.
    seed
        Of all noise, and of who says and watches what.
    """

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self.simulation = Simulation(seed)
        self.finished_at: float | None = None
        self.is_told_to_end = False
        self._began = 0.0
        self._drive = Drive(self.simulation)
        self._camera, self._head = Camera(seed), Head()
        self._sound, self._person = sound.Sound(seed), Person(seed)
        self._television = television.Television(seed)
        self._walk, self._view = Walk(), View(seed)
        self._errands = Errands(self.simulation, self._walk)
        self._steps = 0
        self._outlets = {name: Outlet(folder / f"{name}.sock") for name in DEVICES}

    def step(self, now: float) -> None:
        """Simulate one step that ends at `now` [s], and serve the devices."""
        self._act(now)
        self.simulation.step()
        self._drive.look()
        self._head.step(STEP)
        self._walk.step(STEP)
        self._errands.look()
        self._steps += 1
        self._sense(now)
        if self.simulation.goal_reached and self.finished_at is None:
            self.finished_at = self.simulation.now

    def _act(self, now: float) -> None:
        """Do what the robot wants."""
        for packet in self._outlets["wheels"].poll():
            command = unpack_command(packet)
            if command is not None:
                self.simulation.command(*command)
                self._began = self._began or self.simulation.now
        for packet in self._outlets["arm"].poll():
            angles, closed = unpack_arm(packet)
            self.simulation.hand.move(angles, closed=closed)
        for packet in self._outlets["pan_tilt"].poll():
            self._head.wanted = unpack_angle(packet)
        for packet in self._outlets["screen"].poll():
            screen = unpack_screen(packet)
            self._person.read(screen)
            self._view.judge(now, screen.seen)
            self._walk.is_leading |= screen.said.startswith(FOLLOWS)
        if self._outlets["speakers"].poll():
            self._person.hear(now)
        for packet in self._outlets["remote_control"].poll():
            asked = self._person.asked_for_television
            self._television.take(packet, now, asked)

    def _sense(self, now: float) -> None:
        """Tell the robot what there is."""
        _, x, y, heading = self.simulation.odometry
        hand = self.simulation.hand
        self._outlets["wheels"].push(pack_odometry((now, x, y, heading)))
        self._outlets["arm"].push(pack_arm(hand.angles, closed=hand.is_closed))
        if self._every(laser_model.PERIOD):
            self._outlets["laser"].push(pack_ranges(now, self.simulation.scan()))
        if self._every(SOUND_PERIOD):
            self._speak(now)
        if self._every(CAMERA_PERIOD):
            picture = self._camera.jpeg(hand.cup[0], hand.points)
            self._outlets["cameras"].push(pack_picture(now, picture))
        if self._every(eye_model.PERIOD):
            person = self._walk.place
            view = self._view.picture(now, self.simulation, self._head.angle, person)
            self._outlets["eyes"].push(view)
        if self._every(television.PERIOD) and self._outlets["television"].is_used:
            watched = self._television.watched()
            self._outlets["television"].push(pack_watched(watched))

    def _speak(self, now: float) -> None:
        """Let the person go on speaking, or begin to."""
        listens = self._outlets["microphones"].is_used
        samples = self._person.speak(now, listens=listens)
        if samples is not None:
            self._sound.say(samples)
        was_speaking = self._sound.is_speaking
        block = self._sound.block(self.simulation.pose, self._walk.place)
        self._outlets["microphones"].push(pack_sound(now, block))
        if was_speaking and not self._sound.is_speaking:
            pose = self.simulation.pose
            self._head.judge(sound.bearing(pose, self._walk.place))

    def _every(self, period: float) -> bool:
        """Whether a multiple of `period` [s] fell into the last step."""
        now = self._steps * STEP + 1e-9
        return int(now / period) > int((now - STEP) / period)

    def result(self) -> dict[str, Any]:
        """Return how it went since the first command; lengths in [m]."""
        seconds = (self.finished_at or self.simulation.now) - self._began
        hand = self.simulation.hand
        found = {
            "goal_reached": self.finished_at is not None,
            "seconds": round(seconds, 2),
            **self._drive.result(),
            "cups_placed": hand.placed,
            "cups_dropped": hand.dropped,
            **self._person.result(time.monotonic()),
            **self._head.result(),
            **self._television.result(),
            **self._view.result(),
        }
        return {
            **found,
            "functions": working(found),
            "criteria": criteria(found),
            "tasks": tasks(self._errands.values(), found),
        }

    def end(self) -> None:
        """End after this step; a signal's handler may call it at any moment."""
        self.is_told_to_end = True

    def close(self) -> None:
        """Remove the sockets."""
        for outlet in self._outlets.values():
            outlet.close()


def run(world: World) -> None:
    """Step the world as the clock goes, until it is told to end."""
    held = stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode)
    due = time.monotonic()
    while not world.is_told_to_end:
        due += STEP
        wait = due - time.monotonic()
        if wait < -MOST_BEHIND:
            due -= wait
        if not held:
            time.sleep(max(0.0, wait))
        elif _told_to_end(max(0.0, wait)):
            return
        world.step(time.monotonic())


def _told_to_end(wait: float) -> bool:
    """Wait for `wait` [s]; whether standard input ended meanwhile."""
    end = time.monotonic() + wait
    while True:
        left = max(0.0, end - time.monotonic())
        ready, _, _ = select.select([sys.stdin], [], [], left)
        if not ready:
            return False
        if not os.read(sys.stdin.fileno(), 4096):
            return True


def _seed() -> int:
    """Return the number after ``--seed``; 0 without."""
    words = sys.argv
    return int(words[words.index("--seed") + 1]) if "--seed" in words else 0


def main() -> int:
    """Run the world in the folder POISE_RUN; 2 when that is not given."""
    folder = os.environ.get("POISE_RUN")
    if not folder or not Path(folder).is_dir():
        message = f"POISE_RUN names the folder for the sockets; it is {folder!r}"
        print(message, file=sys.stderr)  # noqa: T201, this is a program
        return 2
    world = World(Path(folder), _seed())
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: world.end())
    try:
        print("ready", flush=True)  # noqa: T201
        run(world)
        print(json.dumps(world.result()), flush=True)  # noqa: T201
    finally:
        world.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
