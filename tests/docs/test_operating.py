"""What the page on operating a robot says of metrics, files and commands is so."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from poise.manage.observe.metrics import METRICS

PAGE = (Path(__file__).parents[2] / "docs/operating.md").read_text()


def test_the_alerts_use_metrics_that_exist() -> None:
    (rules,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (group,) = yaml.safe_load(rules)["groups"]
    names = {n for r in group["rules"] for n in re.findall(r"poise_\w+", r["expr"])}
    assert len(names) > 4
    assert names <= METRICS.keys()
