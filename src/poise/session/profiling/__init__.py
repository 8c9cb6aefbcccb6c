"""Measures what components need, each architecture alone."""
