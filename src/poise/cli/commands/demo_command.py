"""`poise demo`: the paper's case study, which is in `examples/` of a clone."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import typer

from poise.cli.options import AsJson
from poise.errors import UsageError

_CLONE = Path(__file__).parents[4]


def demo_command(
    as_json: AsJson = False,
    scene: Annotated[
        Literal[
            "overload",
            "lost-computer",
            "cut-link",
            "cut-one-link",
            "frozen-agent",
            "manager-killed",
            "tasks",
        ]
        | None,
        typer.Option(help="Show instead how a running robot adapts, or runs tasks."),
    ] = None,
) -> None:
    """Drive a home service robot through a home, placed by hand and by Poise.

    25 components on two emulated computers, as in the paper's case study: first all on
    the main computer that can run there, then where Poise puts them. Takes about a
    minute, and draws both drives in poise-demo.svg.

    With --scene, a small robot adapts by itself: another program overloads one of its
    computers, a computer loses power or is cut off, one link of three is cut, an agent
    is stopped, or the manager is killed amid a move; or three tasks share functions,
    and one pauses another.

    The robots and the home are in the folder `examples` of Poise's repository: run it
    in a clone.

    Examples
    --------
    poise demo

    poise demo --scene overload
    """
    demo = demo_module()
    if scene is None:
        demo.play_drives(as_json=as_json)
    else:
        demo.play_scene(scene, as_json=as_json)


def demo_module() -> ModuleType:
    """Return `examples/demo/play.py` of the clone where this is, or the command runs.

    Raises
    ------
    UsageError
        Neither is a clone.
    """
    for clone in (_CLONE, Path.cwd()):
        if (clone / "examples/demo/play.py").is_file():
            sys.path.insert(0, str(clone))
            return importlib.import_module("examples.demo.play")
    raise UsageError(
        "the demo is in the folder `examples` of Poise's repository, which is not "
        f"installed with Poise: clone it, and run `poise demo` there (not {Path.cwd()})"
    )
