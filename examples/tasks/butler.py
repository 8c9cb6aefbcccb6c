"""Components that work for a while, and then say that their action is done."""

import poise


class Worker(poise.Component):
    """Counts to the end of its work; it goes on where it was after a pause."""

    steps = 20

    def configure(self) -> None:
        """Get ready, which takes a quarter of a second of a core; nothing to do yet."""
        sum(number * number for number in range(3_000_000))
        self.done = self.steps

    def begin(self, action: str) -> None:
        """Begin an action."""
        self.log.info("'%s' begins", action)
        self.done = 0

    @poise.every(0.1, deadline=0.1)
    def work(self) -> None:
        """Do one step."""
        if self.done < self.steps:
            self.done += 1
            if self.done == self.steps:
                self.say_done()

    def say_done(self) -> None:
        """Say that the action is done."""


class Eyes(Worker):
    """Finds something."""

    found: poise.Published[bool]

    def say_done(self) -> None:
        """Say that something was found."""
        self.found.publish(True)


class Wheels(Worker):
    """Drives somewhere."""

    arrived: poise.Published[bool]

    def say_done(self) -> None:
        """Say that the robot is there."""
        self.arrived.publish(True)


class Hand(Worker):
    """Grasps something, which takes longer."""

    steps = 40
    holding: poise.Published[bool]

    def say_done(self) -> None:
        """Say that the hand holds something."""
        self.holding.publish(True)


class Mouth(Worker):
    """Says something."""

    steps = 15
    said: poise.Published[bool]

    def say_done(self) -> None:
        """Say that all was said."""
        self.said.publish(True)
