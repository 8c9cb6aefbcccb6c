"""Moves the arm: kinematics, collisions, trajectory, joints."""
