"""Runs the containers of a computer, and says what becomes of them."""
