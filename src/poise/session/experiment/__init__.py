"""Compares ways to place a robot's components, in many runs of real processes."""
