"""A robot's code on its way to its computers, and what each computer tells of it."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

CODE, PACKAGES, MANIFEST = "code", "packages", "manifest.json"
"""In a version: the robot's own modules, the wheels that they need, what there is."""

SHOWN = 12
"""Digits of a version that people are shown."""
MOST_CODE = 2 << 30
"""No more is stored or unpacked for one version [bytes]."""


class Manifest(Struct, frozen=True, kw_only=True):
    """What an archive of code needs beside what is in it."""

    # Platform (as in `AgentStatus`) -> file name of each wheel -> its SHA-256
    wheels: Mapping[str, Mapping[str, str]] = {}


class CodePart(Struct, frozen=True, tag=True, kw_only=True):
    """Store a part of a file; the whole is checked with its last part.

    It needs no fencing token: nothing runs differently by it.
    """

    file: str  # SHA-256 of the whole file, in hexadecimal digits
    size: int  # Of the whole file [bytes]
    offset: int
    data: bytes


class CodeReceived(Struct, frozen=True, tag=True):
    """An agent's answer: how much of the file it has from the beginning [bytes]."""

    size: int


class InstallCode(Struct, frozen=True, tag=True):
    """Unpack the archive that was sent, with its wheels: all of it, or nothing."""

    version: str  # The archive's SHA-256
