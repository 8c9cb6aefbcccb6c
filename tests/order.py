"""The order of tests: those that take long come first, or as chance wants.

A file whose fixtures are shared, or that bears nothing of its own beside it, runs on
one worker.
"""

from __future__ import annotations

import functools
import random
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController


_TOGETHER = re.compile(r'scope="module"|mark\.one_worker\b')


class Scheduling(LoadScopeScheduling):
    """Gives some files to one worker each, and goes on when a worker has crashed.

    Else what that one had done would be handed out again, as work without a test, for
    whose end all others wait.
    """

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        is_one = stays_together(self.config.rootpath / file)
        return file if is_one else nodeid

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


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Put what is slow, and stays on one worker, first; or shuffle.

    So the workers end together.
    """
    seed = config.getoption("--shuffle")
    if seed is None:
        items.sort(
            key=lambda item: (
                item.get_closest_marker("slow") is None,
                not stays_together(item.path),
            )
        )
    else:
        chance = random.Random(seed)
        chance.shuffle(items)
        files = {item.path: chance.random() for item in items}
        items.sort(key=lambda item: files[item.path])


@functools.cache
def stays_together(file: Path) -> bool:
    """Return whether a file's tests run on one worker."""
    return _TOGETHER.search(file.read_text(encoding="utf-8")) is not None
