"""Robots that run: to observe, to command, to stop."""
