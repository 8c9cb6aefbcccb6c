"""``python -m poise`` is the command `poise`."""

from poise.cli.main import main

main()
