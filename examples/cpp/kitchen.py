"""The parts of the oven that are in Python."""

from __future__ import annotations

from pilot import Learned, Reading

from poise import Component, Published, every, subscribed


class Thermometer(Component):
    """Measures an oven that becomes warmer."""

    reading: Published[Reading]

    def configure(self) -> None:
        self.celsius = 20.0

    @every(0.1, deadline=0.1)
    def look(self) -> None:
        self.celsius += 0.5
        self.reading.publish(Reading(self.celsius, self.clock.stamp()))


class Display(Component):
    """Shows what the controller learned."""

    @subscribed(keep=1)
    def learned(self, message: Learned) -> None:
        self.log.info("%d readings, gain %g", message.readings, message.gain)
