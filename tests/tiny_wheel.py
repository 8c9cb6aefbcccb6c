"""Writes a wheel that pip takes, so that tests need no package index."""

from __future__ import annotations

import zipfile
from pathlib import Path


def make_wheel(folder: Path, version: str, tag: str = "py3-none-any") -> Path:
    """Write a wheel that pip takes."""
    folder.mkdir(exist_ok=True)
    about = f"Metadata-Version: 2.1\nName: tiny\nVersion: {version}\n"
    kind = f"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: {tag}\n"
    info = f"tiny-{version}.dist-info"
    path = folder / f"tiny-{version}-{tag}.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("tiny.py", f"VERSION = {version!r}\n")
        wheel.writestr(f"{info}/METADATA", about)
        wheel.writestr(f"{info}/WHEEL", kind)
        wheel.writestr(f"{info}/RECORD", "")
    return path
