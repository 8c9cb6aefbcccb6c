"""Listens: the spectrum of half a second of sound, twice a second."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from running import run
from std_msgs.msg import String

RATE = 16000
"""[Hz]"""


class Speech(Node):
    """Says which tone it heard; `frames` says how thoroughly it listens."""

    def __init__(self) -> None:
        super().__init__("speech")
        self.frames = self.declare_parameter("frames", 600).value
        self.random = np.random.default_rng(0)
        self.words = self.create_publisher(String, "words", 10)
        self.create_timer(0.5, self.listen)

    def listen(self) -> None:
        time = np.arange(512) / RATE
        tone = 300 + 100 * int(self.random.integers(5))
        power = np.zeros(257)
        for _ in range(self.frames):
            sound = np.sin(2 * np.pi * tone * time) + self.random.normal(0, 1, 512)
            power += np.abs(np.fft.rfft(sound * np.hanning(512)))
        heard = float(power[3:].argmax() + 3) * RATE / 512
        self.words.publish(String(data=f"a tone of {heard:.0f} Hz"))


if __name__ == "__main__":
    run(Speech)
