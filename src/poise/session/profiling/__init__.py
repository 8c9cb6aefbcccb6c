"""Measures what components need, and how fast computers and connectors are."""
