"""Take the pictures in docs/: ``python -m benchmarks.dashboard_pictures``.

They show the dashboard while T-Rot does task `serve`, placed by hand and by Poise.
Adaptation is off, so that it stays where it is.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from benchmarks.dashboard import dashboard

ROOT = Path(__file__).parents[1]
ROBOT = ROOT / "examples/trot/robot.yaml"
WORKS = 12.0
"""The robot has worked for this time [s]: estimates are there, and deadlines passed."""


def take(placement: str, picture: Path) -> None:
    """Start the robot with a placement, and take a picture of its dashboard."""
    words = ["up", str(ROBOT), "--task", "serve", "--no-adapt"]
    with (
        dashboard("t-rot") as (address, _),
        sync_playwright() as driver,
        subprocess.Popen(
            [sys.executable, "-m", "poise", *words, "--placement", placement],
            stdout=subprocess.PIPE,
            text=True,
        ) as up,
    ):
        assert up.stdout is not None
        try:
            assert any("is up" in line for line in up.stdout), "it did not start"
            browser = driver.chromium.launch(
                executable_path="/usr/bin/chromium",
                args=["--no-sandbox", "--disable-dev-shm-usage"],
            )
            page = browser.new_page(viewport={"width": 1200, "height": 760})
            page.goto(address)
            page.wait_for_selector("[data-component]")
            time.sleep(WORKS)
            page.screenshot(path=picture)
            browser.close()
        finally:
            up.terminate()
            up.communicate()


def main() -> None:
    """Take both pictures."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.dashboard_pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "docs")
    arguments = parser.parse_args()
    for placement, name in {"static": "static", "auto": "poise"}.items():
        take(placement, arguments.folder / f"dashboard-{name}.png")


if __name__ == "__main__":
    main()
