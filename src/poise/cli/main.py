"""The entry of `poise`: installs signal handlers first, then imports the rest."""

from __future__ import annotations

from poise.cli.interrupts import interrupts


def main() -> None:
    """Run the command line; docs/command-line.md says the exit codes."""
    interrupts.install()
    from poise.cli.commands import run

    run()
