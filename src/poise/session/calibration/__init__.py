"""Measures how fast computers are, and what connectors cost."""
