"""Robots that are written for one test."""

from __future__ import annotations

import os
from pathlib import Path


def written(folder: Path, name: str, module: str, code: str, text: str) -> Path:
    """Write a robot and the module of its components; return its file.

    The name is of this test run alone, for the sets of a user are found by name.
    """
    (folder / f"{module}.py").write_text(code)
    file = folder / "robot.yaml"
    file.write_text(text.format(name=f"{name}-{os.getpid()}", folder=folder))
    return file
