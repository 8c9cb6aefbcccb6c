"""The simulated cell as a process: ``POISE_RUN=/tmp/run python -m sorter.world``.

It serves the devices' sockets in the folder POISE_RUN, says ``ready``, and runs until
SIGTERM comes, or its standard input ends when that is a pipe (so that it does not
outlive who holds the other end). ``--seed 3`` is another world. The last line it prints
is a JSON object that says how it went.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import stat
import sys
import time
from pathlib import Path
from typing import Any

from sorter import cell
from sorter.device import NAMES
from sorter.world.judge import result
from sorter.world.outlet import Outlet
from sorter.world.scene import STEP, Scene
from sorter.world.sensors import Sensors

MOST_BEHIND = 0.1
"""[s] A world further behind the clock than this lets the rest of the time go."""

FRESH = 1.0
"""[s] An older picture on the screen helps no operator."""


class World:
    """The scene, and the sockets through which the robot meets it."""

    def __init__(self, folder: Path, seed: int = 0) -> None:
        self.scene, self._sensors = Scene(seed), Sensors(seed)
        self._outlets = {name: Outlet(folder / f"{name}.sock") for name in NAMES}
        self._steps = self._fresh = self._shown_steps = 0
        self._shown_at = 0.0
        self.is_told_to_end = False

    def step(self, now: float) -> None:
        """Simulate one step that ends at `now` [s], and serve the devices."""
        devices, scene = self._outlets, self.scene
        for (angles,) in devices["arm"].poll():
            scene.command(angles)
        scene.step()
        for (closed,) in devices["gripper"].poll():
            scene.grip(closed=closed)
        for taken, _ in devices["screen"].poll():
            self._shown_at = taken
        self._steps += 1
        devices["arm"].push(scene.angles.tolist())
        devices["gripper"].push(scene.held is not None)
        if self._every(cell.SCANNER_PERIOD):
            devices["scanner"].push(now, self._sensors.ranges(scene))
        if self._every(cell.CAMERA_PERIOD):
            devices["camera"].push(now, self._sensors.picture(scene))
        if scene.now > FRESH:
            self._shown_steps += 1
            self._fresh += now - self._shown_at < FRESH

    def _every(self, period: float) -> bool:
        """Whether a multiple of `period` [s] fell into the last step."""
        now = self._steps * STEP + 1e-9
        return int(now / period) > int((now - STEP) / period)

    def result(self) -> dict[str, Any]:
        """Return how it went since the first command."""
        steps = self._shown_steps
        return result(self.scene, self._fresh / steps if steps else None)

    def end(self) -> None:
        """End after this step; a signal's handler may call it at any moment."""
        self.is_told_to_end = True

    def close(self) -> None:
        """Remove the sockets."""
        for outlet in self._outlets.values():
            outlet.close()


def run(world: World) -> None:
    """Step the world as the clock goes, until it is told to end."""
    is_held = stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode)
    due = time.monotonic()
    while not world.is_told_to_end:
        due += STEP
        wait = max(due - time.monotonic(), 0.0)
        due = max(due, time.monotonic() - MOST_BEHIND)
        if is_held and select.select([sys.stdin], [], [], wait)[0]:
            return  # nobody writes: it has ended
        if not is_held:
            time.sleep(wait)
        world.step(time.monotonic())


def main() -> int:
    """Run the world in the folder POISE_RUN; 2 when that is not given."""
    parser = argparse.ArgumentParser("python -m sorter.world", description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--endless", action="store_true", help="it always is")
    options = parser.parse_args()
    folder = os.environ.get("POISE_RUN")
    if not folder or not Path(folder).is_dir():
        message = f"POISE_RUN names the folder for the sockets; it is {folder!r}"
        print(message, file=sys.stderr)  # noqa: T201, this is a program
        return 2
    world = World(Path(folder), options.seed)
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
