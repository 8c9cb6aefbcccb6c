"""Reads what the containers of a computer use, and whether they respond."""
