"""What the camera sees: where a bright spot is, by correlation at many scales."""

from __future__ import annotations

import cv2
import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from running import run
from sensor_msgs.msg import Image

cv2.setNumThreads(1)


class Detector(Node):
    """Looks at every picture; `scales` says how thoroughly."""

    def __init__(self) -> None:
        super().__init__("detector")
        self.scales = self.declare_parameter("scales", 4).value
        self.points = self.create_publisher(PointStamped, "detections", 1)
        self.create_subscription(Image, "image", self.look, 1)

    def look(self, message: Image) -> None:
        flat = np.frombuffer(message.data, np.uint8)
        grey = flat.reshape(message.height, message.width, 3).mean(axis=2, dtype="f4")
        point = PointStamped(header=message.header)
        best = -1.0
        for scale in range(self.scales):
            side = 12 + 4 * scale
            spot = np.full((side, side), 250, np.float32)
            fits = cv2.matchTemplate(grey, spot, cv2.TM_SQDIFF)
            _, _, place, _ = cv2.minMaxLoc(fits)
            score = 1 / (1 + float(fits.min()) / side**2)
            if score > best:
                best, (point.point.x, point.point.y) = score, map(float, place)
        self.points.publish(point)


if __name__ == "__main__":
    run(Detector)
