"""Emulated computers that a process keeps for others, and faults to rehearse there."""
