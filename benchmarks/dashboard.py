"""What the dashboard costs, and how smooth it is: ``python -m benchmarks.dashboard``.

A manager tells of a robot that is made up, all of whose figures change all the time;
`poise dashboard` shows it, and headless Chromium opens it. Measured are the CPU time of
the dashboard's process when nobody looks, with one page and with ten; and the frames
that a page draws, against those that an empty page draws at the same time. Over a slow
link (`--kbit` a second, 200 ms each way): how long the page takes to load, how often
updates arrive, how old they are then, and what memory the dashboard's process needs for
it.

It imports internal modules: the robot is made up below the control socket.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.synthetic.slow_link import SlowLink
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


_SENT_AT = re.compile(r'"show.*?(\d{10}\.\d+), ?(?:true|false)\]')
"""In an update, when it was sent [s since 1970]."""
_LOADS_WITHIN = 120_000
"""[ms]"""


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


def _memory(pid: int) -> int:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _opened(browser: Any, address: str, components: int) -> Any:
    page = browser.new_context().new_page()
    _open(page, address, components)
    return page


def _open(page: Any, address: str, components: int) -> None:
    page.goto(address, timeout=_LOADS_WITHIN)
    page.wait_for_function(
        "n => document.querySelectorAll('[data-component]').length === n",
        arg=components,
        timeout=_LOADS_WITHIN,
    )


def _over_slow_link(
    browser: Any, address: str, components: int, seconds: float, kbit: float
) -> tuple[float, list[float]]:
    """Return what a page takes to load, and how old each update then is [s]."""
    ages: list[float] = []

    def note(frame: str) -> None:
        if sent := _SENT_AT.search(frame):
            ages.append(time.time() - float(sent[1]))

    with SlowLink(address) as link:
        link.rate, link.delay = 1e3 * kbit / 8, 0.2
        page = browser.new_context().new_page()
        page.on("websocket", lambda socket: socket.on("framereceived", note))
        began = time.monotonic()
        _open(page, link.address, components)
        loaded = time.monotonic() - began
        ages.clear()
        page.wait_for_timeout(1000 * seconds)
        page.context.close()
    return loaded, ages


def measure(components: int, seconds: float, kbit: float) -> Mapping[str, float]:
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
        before = _memory(pid)
        loaded, ages = _over_slow_link(browser, address, components, seconds, kbit)
        figures["seconds to load over a slow link, the first time"] = loaded
        figures["seconds between updates over a slow link"] = seconds / len(ages)
        figures["seconds until one has arrived, median"] = median(ages)
        figures["seconds until one has arrived, at most"] = max(ages)
        figures["MB of memory it takes"] = (_memory(pid) - before) / 1e6
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
    parser.add_argument("--kbit", type=float, default=100.0, help="the link's rate")
    arguments = parser.parse_args()
    for components in arguments.components:
        sys.stdout.write(f"{components} components\n")
        measure(components, arguments.seconds, arguments.kbit)


if __name__ == "__main__":
    main()
