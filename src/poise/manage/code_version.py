"""Tells whether the code of a component has changed since it was started."""

from __future__ import annotations

import hashlib
from pathlib import Path


def code_version(folder: str, implementation: str) -> str:
    """Return a digest of the file of a class.

    It is empty for a class that does not lie in the robot's folder. What that file
    imports is not looked at.

    Parameters
    ----------
    folder
        The robot's.
    implementation
        ``package.module:Class``.
    """
    path = Path(folder, *implementation.partition(":")[0].split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        try:
            return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
        except OSError:
            continue
    return ""
