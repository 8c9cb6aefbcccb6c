"""The command line: a thin skin over `poise.session`."""
