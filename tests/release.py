"""Another release of Poise: this one's code with another protocol, in an environment.

It has another version, and differs as releases may: the status of its agents has a
field that this release does not know, and lacks one.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

import poise

_SITE = Path(str(distribution("poise").locate_file("")))


def make_release(folder: Path, version: str, protocol: int) -> Path:
    """Install a release into an environment of its own; return its Python."""
    venv.create(folder, symlinks=True)
    minor = f"python{sys.version_info.major}.{sys.version_info.minor}"
    site = folder / "lib" / minor / "site-packages"
    # its dependencies; a path in such a file has no such files read itself
    (site / "dependencies.pth").write_text(f"{_SITE}\n")
    for source in (_SITE / "poise", Path(poise.__file__).parent):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source, site / "poise", ignore=ignored, dirs_exist_ok=True)
    info = site / f"poise-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: poise\nVersion: {version}\n"
    )
    _edit(site / "poise/version.py", (r"^VERSION = .*", f'VERSION = "{version}"'))
    records = site / "poise/wire/records"
    _edit(
        records / "request_records.py",
        (r"^PROTOCOL = \d+", f"PROTOCOL = {protocol}"),
        (r"^LEAST_PROTOCOL = \d+", f"LEAST_PROTOCOL = {protocol - 1}"),
    )
    _edit(
        records / "status_records.py", (r"^    version: str = .*", "    old: int = 7")
    )
    _edit(site / "poise/runtime/agent/core.py", (r"version=world\.version", "old=8"))
    return folder / "bin/python"


def _edit(path: Path, *changes: tuple[str, str]) -> None:
    text = path.read_text()
    for pattern, new in changes:
        text, number = re.subn(pattern, new, text, flags=re.MULTILINE)
        assert number == 1, f"{path} has {number} of {pattern}"
    path.write_text(text)


def environment() -> dict[str, str]:
    """Return an environment in which each release finds itself first."""
    return {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
