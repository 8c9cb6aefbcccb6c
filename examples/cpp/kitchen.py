"""The parts of the oven that are in Python: a thermometer, and another heater."""

from __future__ import annotations

from pilot import Heating, Reading

from poise import Component, Provided, Published, every


class Thermometer(Component):
    """Measures the temperature of an oven that the heater warms."""

    reading: Published[Reading]

    def configure(self) -> None:
        self.celsius = 20.0

    @every(0.1, deadline=0.1)
    def measure_now(self) -> None:
        self.celsius += 0.5
        self.reading.publish(Reading(self.celsius, self.clock.stamp()))


class Heater(Component):
    """Heats, in Python: swap it for `pilot:Heater`, and the calls stay in C++."""

    heating: Provided[Heating]

    def heat(self, power: float) -> float:
        if not 0 <= power <= 1:
            raise ValueError(f"power is {power}, must lie between 0 and 1")
        return power * 2000

    def note(self, text: str) -> None:
        self.log.info("%s", text)
