"""Starts a robot on its computers, and leaves nothing behind."""
