"""Prepares the components of the next actions in what the running ones leave free."""
