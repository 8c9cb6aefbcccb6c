"""Decides where components run, before a robot starts."""
