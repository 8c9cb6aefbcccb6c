"""The commands: one file for each, and one for those to a running robot."""
