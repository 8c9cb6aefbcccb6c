"""A camera: 320 x 240 pixels, ten times a second."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from running import run
from sensor_msgs.msg import Image

ROWS, COLUMNS = 240, 320


class Camera(Node):
    """Publishes noise with a bright spot that wanders."""

    def __init__(self) -> None:
        super().__init__("camera")
        self.random, self.count = np.random.default_rng(0), 0
        self.images = self.create_publisher(Image, "image", 1)
        self.create_timer(0.1, self.shoot)

    def shoot(self) -> None:
        pixels = self.random.integers(0, 60, (ROWS, COLUMNS, 3), np.uint8)
        column = 3 * self.count % (COLUMNS - 20)
        pixels[100:120, column : column + 20] = 250
        self.count += 1
        message = Image(height=ROWS, width=COLUMNS, encoding="rgb8", step=3 * COLUMNS)
        message.header.stamp = self.get_clock().now().to_msg()
        message.data = pixels.tobytes()
        self.images.publish(message)


if __name__ == "__main__":
    run(Camera)
