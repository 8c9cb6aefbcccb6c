"""Runs a robot's manager and agents in virtual time, under a seed and with faults."""
