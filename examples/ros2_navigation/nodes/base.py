"""The base and its laser, simulated: the home that T-Rot drives in."""

from __future__ import annotations

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from running import run
from sensor_msgs.msg import LaserScan

from trot.laser_model import ANGLES, MAX_RANGE
from trot.world.simulation import STEP, Simulation

SCAN_EVERY = 5
"""Steps of the simulation: 10 Hz."""


class Base(Node):
    """Publishes scans and odometry, and takes speeds."""

    def __init__(self) -> None:
        super().__init__("base")
        self.simulation, self.steps = Simulation(), 0
        self.scans = self.create_publisher(LaserScan, "scan", 10)
        self.odometry = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(TwistStamped, "cmd_vel", self.command, 1)
        self.create_timer(STEP, self.step)

    def command(self, message: TwistStamped) -> None:
        self.simulation.command(message.twist.linear.x, message.twist.angular.z)

    def step(self) -> None:
        self.simulation.step()
        self.steps += 1
        if self.steps % SCAN_EVERY:
            return
        stamp = self.get_clock().now().to_msg()
        _, x, y, heading = self.simulation.odometry
        odometry = Odometry()
        odometry.header.stamp = stamp
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = x, y
        odometry.pose.pose.position.z = heading
        self.odometry.publish(odometry)
        scan = LaserScan(range_max=MAX_RANGE, angle_min=float(ANGLES[0]))
        scan.header.stamp, scan.header.frame_id = stamp, "laser"
        scan.angle_increment = float(ANGLES[1] - ANGLES[0])
        scan.ranges = self.simulation.scan().tolist()
        self.scans.publish(scan)


if __name__ == "__main__":
    run(Base)
