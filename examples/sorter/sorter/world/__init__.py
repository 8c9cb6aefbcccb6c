"""The simulated cell, which is no part of the robot: see `python -m sorter.world`."""
