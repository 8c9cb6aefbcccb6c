"""Runs the containers of a computer, measures them, and says what becomes of them."""
