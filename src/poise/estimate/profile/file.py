"""A profile as a YAML file beside the robot file."""

from __future__ import annotations

from pathlib import Path

import msgspec
import yaml

from poise.errors import RobotError
from poise.estimate.profile import Profile

_HEAD = """\
# Written by `poise profile`; do not edit it.
# CPU in cores of the reference computer, memory and sizes in bytes, times in seconds.
"""
_DIGITS = 4
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The quick one is not everywhere."""


def to_text(profile: Profile) -> str:
    """Return the profile as YAML; numbers keep `_DIGITS` digits."""
    plain = _rounded(msgspec.to_builtins(profile))
    return _HEAD + yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)


def from_text(text: str, file: str) -> Profile:
    """Return the profile in a YAML text.

    Raises
    ------
    RobotError
        It is not a profile; the message names `file` and the problem.
    """
    try:
        return msgspec.convert(yaml.load(text, _LOADER), Profile)  # noqa: S506 - both are safe
    except yaml.YAMLError as error:
        raise RobotError(f"{file}: not YAML: {error}") from error
    except msgspec.ValidationError as error:
        raise RobotError(
            f"{file}: not a profile: {error}. Write it again with `poise profile`"
        ) from error


def read(path: Path) -> Profile:
    """Return the profile in a file; raises as `from_text`, and when it cannot be read.

    Raises
    ------
    RobotError
        It cannot be read, or is no profile.
    """
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise RobotError(
            f"profile {path} cannot be read: {error}. `poise profile` writes it"
        ) from error
    return from_text(text, str(path))


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
