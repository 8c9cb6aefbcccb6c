"""`poise ros2 import`: a running ROS 2 graph is observed, and becomes a robot file.

Only `observer` and `topic_probe` need rclpy.
"""
