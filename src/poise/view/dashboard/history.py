"""How loads, ages and misses were over the last ten minutes. Pure."""

from __future__ import annotations

from typing import Any

from poise.view.robot_view import Look

Records = dict[str, dict[str, Any]]
Page = dict[str, Records]
"""Part -> name -> what is shown of it."""

SPAN = 600
"""How many moments are kept, one a second: ten minutes."""


class RecentHistory:
    """Notes a moment each second, with None for what was not known then."""

    def __init__(self) -> None:
        self._moments: Records = {}
        self._before: dict[str, tuple[int, float]] = {}

    def note(self, page: Page, look: Look) -> None:
        """Note how a page is, unless that was done within this second already."""
        second = str(int(look.at))
        if second in self._moments or look.trouble:
            return
        self._moments[second] = {
            "cpu": {n: _share(each) for n, each in page["computers"].items()},
            "ages": {n: self._age(n, each) for n, each in page["chains"].items()},
            "late": _late(page),
        }
        while len(self._moments) > SPAN:
            del self._moments[next(iter(self._moments))]

    def moments(self) -> Records:
        """Return second [s since 1970] -> what was seen then."""
        return dict(self._moments)

    def _age(self, name: str, chain: dict[str, Any]) -> float | None:
        """Return the mean age since the last moment, as a share of the deadline."""
        uses, total = chain["uses"], chain["uses"] * chain["mean"]
        before, total_before = self._before.get(name, (uses, total))
        self._before[name] = uses, total
        if not chain["known"] or uses <= before:
            return None
        return _digits((total - total_before) / (uses - before) / chain["deadline"])


def _share(computer: dict[str, Any]) -> float | None:
    used, capacity = computer.get("used"), computer.get("capacity")
    return _digits(used / capacity) if capacity and used is not None else None


def _late(page: Page) -> float | None:
    """Return the largest share of deadlines that a timer misses now."""
    shares = [each["now"] for each in page["timers"].values() if each["deadline"]]
    known = [share for share in shares if share is not None]
    return max(known) if known else None


def _digits(value: float) -> float:
    return float(f"{value:.3g}")
