"""The command line, a thin skin over `poise.session`; `command_table` has the files."""
