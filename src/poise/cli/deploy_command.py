"""`poise deploy`: sends a robot's code to its computers."""

from __future__ import annotations

import sys

from poise.cli.main import Interrupts
from poise.cli.options import AsJson, RobotFile, Set, arguments_of, show
from poise.session.deploy.deploy import deploy
from poise.session.robot_file import load


def deploy_command(file: RobotFile, as_json: AsJson = False, set_: Set = None) -> None:
    """Send a robot's code to its computers, beside the code that is there.

    It packs what components import from the folders of the robot file and of its
    `repository`. Nothing that runs changes: the next `poise up` runs the new version.
    A computer that lacks room, or that is lost meanwhile, keeps what it has.

    Example: poise deploy robot.yaml
    """
    robot = load(file, arguments_of(set_), say=_say)
    with Interrupts() as interrupts:
        deployed = deploy(robot, say=_say, check=interrupts.check)
    show(deployed, [str(deployed)], as_json=as_json)


def _say(sentence: str) -> None:
    sys.stderr.write(f"{sentence}\n")
