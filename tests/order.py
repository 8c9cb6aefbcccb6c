"""The order of tests: those that take long come first, or as chance wants.

What shares agents runs on one worker, for its file's fixtures are made once there.
"""

from __future__ import annotations

import random

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Put the slow tests first, so that the workers end together; or shuffle."""
    for item in items:
        if _shares_fixtures(item):
            item.add_marker(pytest.mark.xdist_group(item.path.name))
    seed = config.getoption("--shuffle")
    if seed is None:
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)
    else:
        chance = random.Random(seed)
        chance.shuffle(items)
        files = {item.path: chance.random() for item in items}
        items.sort(key=lambda item: files[item.path])


def _shares_fixtures(item: pytest.Item) -> bool:
    if not isinstance(item, pytest.Function):
        return False
    fixtures = item._fixtureinfo.name2fixturedefs.values()
    return any(each.scope == "module" for defs in fixtures for each in defs)
