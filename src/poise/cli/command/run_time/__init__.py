"""Commands that start, watch, change and stop robots."""
