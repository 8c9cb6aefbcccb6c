"""``python -m poise`` is the command `poise`."""

from poise.cli.main import run_process

run_process()
