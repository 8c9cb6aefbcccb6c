"""What the dashboard costs, and how smooth it is: ``python -m benchmarks.dashboard``.

A manager tells of a robot that is made up, all of whose figures change all the time;
`poise dashboard` shows it, and headless Chromium opens it. Measured are the CPU time of
the dashboard's process when nobody looks, with one page and with ten; the frames that a
page draws, against those that an empty page draws at the same time; and how old a page
is over a slow link (400 ms there and back, 50 kB/s).

It imports internal modules: the robot is made up below the control socket.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from benchmarks.synthetic.statuses import told

FRAMES = """(seconds) => new Promise((done) => {
  let frames = 0, began = performance.now();
  const draw = (now) => {
    frames++;
    if (now - began < 1000 * seconds) requestAnimationFrame(draw);
    else done(1000 * frames / (now - began));
  };
  requestAnimationFrame(draw);
})"""
SLOW = {"offline": False, "latency": 400, "downloadThroughput": 5e4}


class _Said(dict[str, float]):
    """Figures that are printed as they come."""

    def __setitem__(self, name: str, figure: float) -> None:
        super().__setitem__(name, figure)
        sys.stdout.write(f"  {name}: {figure:.3g}\n")
        sys.stdout.flush()


@contextmanager
def dashboard(robot: str) -> Iterator[tuple[str, int]]:
    """Serve the page; yield its address and process."""
    words = [sys.executable, "-m", "poise", "dashboard", robot, "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            yield server.stdout.readline().split()[4].rstrip(";"), server.pid
        finally:
            server.terminate()


def cpu(pid: int, seconds: float) -> float:
    """Return what a process uses for so long [cores]."""
    before, began = _cpu_time(pid), time.monotonic()
    time.sleep(seconds)
    return (_cpu_time(pid) - before) / (time.monotonic() - began)


def _cpu_time(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _opened(browser: Any, address: str, components: int) -> Any:
    page = browser.new_context().new_page()
    page.goto(address)
    page.wait_for_function(
        "n => document.querySelectorAll('[data-component]').length === n",
        arg=components,
        timeout=60_000,
    )
    return page


def _age_when_slow(
    browser: Any, address: str, components: int, seconds: float
) -> float:
    """Return the time between updates of a page over a slow link [s]."""
    page = _opened(browser, address, components)
    link = page.context.new_cdp_session(page)
    link.send("Network.emulateNetworkConditions", {**SLOW, "uploadThroughput": 5e4})
    updates = page.evaluate(
        """(seconds) => new Promise((done) => {
          let updates = 0, before = "";
          const look = setInterval(() => {
            const now = document.querySelector(".load").textContent;
            if (now !== before) updates++;
            before = now;
          }, 20);
          setTimeout(() => { clearInterval(look); done(updates); }, 1000 * seconds);
        })""",
        seconds,
    )
    page.context.close()
    return seconds / max(1, int(updates))


def measure(components: int, seconds: float) -> Mapping[str, float]:
    """Measure with a robot of so many components, each figure for so long [s]."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415, tests skip without it

    name = f"made-up-{os.getpid()}"
    figures = _Said()
    with ExitStack() as stack:
        stack.enter_context(told(name, components))
        address, pid = stack.enter_context(dashboard(name))
        driver = stack.enter_context(sync_playwright())
        browser = driver.chromium.launch(
            executable_path="/usr/bin/chromium",
            args=["--no-sandbox", "--disable-dev-shm-usage"],
        )
        stack.callback(browser.close)
        pages = [_opened(browser, address, components)]
        time.sleep(1.0)
        figures["cores with 1 page"] = cpu(pid, seconds)
        empty = browser.new_context().new_page()
        empty.bring_to_front()
        figures["frames/s of an empty page"] = empty.evaluate(FRAMES, seconds)
        empty.close()
        pages[0].bring_to_front()
        figures["frames/s"] = pages[0].evaluate(FRAMES, seconds)
        slow = _age_when_slow(browser, address, components, seconds)
        figures["seconds between updates over a slow link"] = slow
        pages += [_opened(browser, address, components) for _ in range(9)]
        time.sleep(1.0)
        figures["cores with 10 pages"] = cpu(pid, seconds)
        for page in pages:
            page.context.close()
        time.sleep(5.0)  # the server lets a lost page come back for some time
        figures["cores when nobody looks"] = cpu(pid, seconds)
    return figures


def main() -> None:
    """Print what is measured with 5 and with 200 components."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.dashboard",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="for each figure")
    parser.add_argument("--components", type=int, nargs="*", default=[5, 200])
    arguments = parser.parse_args()
    for components in arguments.components:
        sys.stdout.write(f"{components} components\n")
        measure(components, arguments.seconds)


if __name__ == "__main__":
    main()
