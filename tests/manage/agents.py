"""Agents as processes of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def agent(
    robot: str, name: str, ports: dict[str, int], folder: Path, lifeline: int
) -> subprocess.Popen[bytes]:
    """Start the agent of one of the computers in `ports`."""
    argv = [sys.executable, "-m", "poise", "agent", name, "--robot", robot]
    argv += ["--address", "127.0.0.1", "--port", str(ports[name])]
    argv += ["--folder", str(folder / name), "--lifeline", str(lifeline)]
    for other, port in ports.items():
        if other != name:
            argv += ["--peer", f"127.0.0.1:{port}"]
    return subprocess.Popen(argv, pass_fds=[lifeline], stderr=subprocess.DEVNULL)
