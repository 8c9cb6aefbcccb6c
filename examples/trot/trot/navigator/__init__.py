"""Drives the robot to its goal: laser, pose, map, path, wheels."""
