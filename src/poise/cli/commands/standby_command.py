"""`poise standby`: wait on a robot's computer to lead the robot."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from poise.session.standby import stand_by


def standby_command(
    computer: Annotated[str, typer.Argument(help="This computer's name.")],
    claim: Annotated[Path, typer.Option(help="The file of the agent's last claim.")],
) -> None:
    """Wait to lead a robot when its manager is gone.

    Agents start it where the robot file says `manager`, and tell it when to lead, by a
    line `lead` on its standard input.

    Example: poise standby main --claim /tmp/poise-agent-0-1f2e/claim
    """

    def say(sentence: str) -> None:
        with contextlib.suppress(OSError):  # nobody reads it
            at = time.strftime("%H:%M:%S")
            sys.stderr.write(f"{at} standby on '{computer}': {sentence}\n")

    stand_by(claim, sys.stdin, say)
