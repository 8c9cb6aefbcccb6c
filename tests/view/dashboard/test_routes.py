"""Connectors go through the gaps between boxes."""

from __future__ import annotations

import itertools
import json
import random
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from poise.view import dashboard
from tests.waiting import LONG

_NODE = shutil.which("node")
_ROUTES = Path(dashboard.__file__).with_name("routes.js")
_POINT = re.compile(r"[ML]([-\d.]+) ([-\d.]+)|Q[-\d.]+ [-\d.]+ ([-\d.]+) ([-\d.]+)")


def card(name: str, left: float, top: float, columns: int, rows: int) -> dict[str, Any]:
    """Return a computer as a browser lays it out: boxes of 160 x 48 pixels."""
    boxes = [
        {
            "name": f"{name}-{column}-{row}",
            "left": left + 27 + 187 * column,
            "right": left + 187 + 187 * column,
            "top": top + 90 + 68 * row,
            "bottom": top + 138 + 68 * row,
        }
        for column in range(columns)
        for row in range(rows)
    ]
    bottom, right = top + 90 + 68 * rows, left + 27 + 187 * columns
    return {"left": left, "top": top, "right": right, "bottom": bottom, "boxes": boxes}


def points(path: str) -> list[tuple[float, float]]:
    """Return a path's points, without what rounds its corners."""
    found = (match.groups() for match in _POINT.finditer(path))
    return [(float(a or c), float(b or d)) for a, b, c, d in found]


@pytest.mark.slow
@pytest.mark.skipif(_NODE is None, reason="no node to run it: apt-get install nodejs")
@pytest.mark.parametrize(
    "cards",
    [
        [card("main", 16, 160, 3, 7), card("vision", 640, 160, 3, 2)],
        [
            card(f"c{n}", 16 + 640 * (n % 2), 160 + 700 * (n // 2), 3, 7)
            for n in range(10)
        ],
        [card("main", 16, 160, 1, 7), card("vision", 16, 800, 1, 9)],
    ],
    ids=["two computers", "ten computers", "a phone"],
)
def test_no_connector_passes_behind_a_box(
    cards: list[dict[str, Any]], tmp_path: Path
) -> None:
    rng = random.Random(7)
    boxes = [box for each in cards for box in each["boxes"]]
    wires = [
        {"name": str(number), "source": a["name"], "target": b["name"], "kind": kind}
        for number, kind in enumerate(["direct", "local", "remote"] * 30)
        for a, b in [rng.sample(boxes, 2)]
    ]
    shutil.copy(_ROUTES, tmp_path / "routes.mjs")
    code = (
        'import { routed } from "./routes.mjs";'
        f"console.log(JSON.stringify(routed({json.dumps(cards)}, {json.dumps(wires)})))"
    )
    (tmp_path / "run.mjs").write_text(code)
    done = subprocess.run(
        [str(_NODE), "run.mjs"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=True,
    )
    paths: dict[str, str] = json.loads(done.stdout)
    assert len(paths) == len(wires)
    for name, path in paths.items():
        way = points(path)
        for (ax, ay), (bx, by) in itertools.pairwise(way):
            for box in boxes:
                beside = (
                    max(ax, bx) <= box["left"] + 1
                    or min(ax, bx) >= box["right"] - 1
                    or max(ay, by) <= box["top"] + 1
                    or min(ay, by) >= box["bottom"] - 1
                )
                assert beside, f"{wires[int(name)]} behind {box['name']}"
