"""Checks of a robot whose file is well formed; pure."""
