"""Closes and opens the hand at the planned moments."""

from __future__ import annotations

import math

from poise import Component, Published, every, subscribed
from sorter.device import Device
from sorter.messages import Grip


class Gripper(Component):
    """Commands the hand 50 times a second, and says when it begins or ends to hold."""

    held: Published[bool]

    def configure(self) -> None:
        self._hand = Device(self.device("gripper"))
        self._closed = self._closes = self._holds = False
        self._due = math.inf

    @subscribed(keep=1)
    def grip(self, message: Grip) -> None:
        self._apply()
        if (age := self.clock.since(message.begins)) is not None:
            self._due = self.clock.now() - age.value + message.after
            self._closes = message.closed

    @every(0.02, deadline=0.02)
    def control(self) -> None:
        self._apply()
        self._hand.send(self._closed)
        packet = self._hand.newest()
        if packet is not None and packet[0] != self._holds:
            self._holds = bool(packet[0])
            self.held.publish(self._holds)

    def _apply(self) -> None:
        if self.clock.now() >= self._due:
            self._closed, self._due = self._closes, math.inf

    def cleanup(self) -> None:
        self._hand.close()
