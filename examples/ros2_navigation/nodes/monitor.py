"""How regularly the controller controls: its rate, and how often it is late."""

from __future__ import annotations

import time

from geometry_msgs.msg import TwistStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from running import run

EVERY = 5.0
"""[s] from line to line."""
LATE = 0.1
"""[s] The controller's period is half of this."""


class Monitor(LifecycleNode):
    """Prints a line of figures."""

    def __init__(self) -> None:
        super().__init__("monitor")
        self.gaps: list[float] = []
        self.last = time.monotonic()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.create_subscription(TwistStamped, "cmd_vel", self.take, 100)
        self.create_timer(EVERY, self.say)
        return super().on_activate(state)

    def take(self, _message: TwistStamped) -> None:
        now = time.monotonic()
        self.gaps.append(now - self.last)
        self.last = now

    def say(self) -> None:
        rate, late = len(self.gaps) / EVERY, sum(gap > LATE for gap in self.gaps)
        longest = 1000 * max(self.gaps, default=0.0)
        print(  # noqa: T201, what it is for
            f"controller {rate:.1f} Hz, {late} late, longest gap {longest:.0f} ms",
            flush=True,
        )
        self.gaps.clear()


if __name__ == "__main__":
    run(Monitor)
