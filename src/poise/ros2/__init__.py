"""ROS 2 beside Poise: rclpy nodes as components, bridges between ports and topics.

Only what runs a node imports rclpy.
"""
