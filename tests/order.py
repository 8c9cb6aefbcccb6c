"""The order of tests: those that take long come first, or as chance wants.

What shares agents runs on one worker, for its file's fixtures are made once there.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from xdist.scheduler import LoadGroupScheduling

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController


class Scheduling(LoadGroupScheduling):
    """Goes on when a worker has crashed.

    Else what that one had done would be handed out again, as work without a test, for
    whose end all others wait.
    """

    def remove_node(self, node: WorkerController) -> str | None:
        """Let others do what a worker has not done; return the test that crashed it."""
        work = {
            group: [test for test, done in tests.items() if not done]
            for group, tests in self.assigned_work.pop(node).items()
        }
        left: list[tuple[str, str]] = [
            (group, test) for group, tests in work.items() for test in tests
        ]
        if not left:
            return None
        (_, crashed), *others = left
        for group, test in others:
            self.workqueue.setdefault(group, {})[test] = False
        for other in self.assigned_work:
            self._reschedule(other)
        return crashed


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scheduling:
    """Say who hands out the tests."""
    return Scheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> Iterator[None]:
    """Put what is slow, and stays on one worker, first; or shuffle.

    So the workers end together.
    """
    for item in items:  # before xdist looks for it
        if _shares_fixtures(item):
            item.add_marker(pytest.mark.xdist_group(item.path.name))
    yield
    seed = config.getoption("--shuffle")
    if seed is None:
        items.sort(
            key=lambda item: (
                item.get_closest_marker("slow") is None,
                item.get_closest_marker("xdist_group") is None,
            )
        )
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
