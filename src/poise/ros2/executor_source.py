"""Gets the callbacks of a ROS 2 node that are due; its component's thread runs them.

So they run in the component's exclusion: a move pauses them, a lease fences them, their
CPU time is the component's, and what they raise is an error of it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from poise.runtime.execution.mailbox import Work


class ExecutorSource:
    """One node's executor as a `WorkSource` of work."""

    def __init__(self, node: Any, give_up: Callable[[str], None]) -> None:  # noqa: ANN401, a node
        from rclpy import executors  # noqa: PLC0415, only where a node runs

        self._executor = executors.SingleThreadedExecutor()
        self._node = node
        self._executor.add_node(node)
        self._returns = (
            executors.TimeoutException,
            executors.ConditionReachedException,
        )
        self._give_up = give_up
        self._is_woken = self._is_waiting = False
        self._task: Any = None

    def wait(self, limit: float | None) -> Work | None:
        """Wait up to `limit` [s] for a callback that is due, or until `wake`."""
        self._is_waiting = True
        try:
            with self._node.handle:  # raises where its code has destroyed it
                pass
            task, entity, _ = self._executor.wait_for_ready_callbacks(
                limit, None, self._woken
            )
        except self._returns:
            return None
        # whatever ROS 2 raises here: nothing of the node would run any more
        except Exception as error:  # noqa: BLE001
            self._give_up(_why_ended(error))
            self._woken = lambda: True  # type: ignore[method-assign]
            return None
        finally:
            self._is_waiting = self._is_woken = False
        self._task = task
        return _what(entity), partial(_run, task)

    def wake(self) -> None:
        """Let `wait` return."""
        self._is_woken = True
        if self._is_waiting:
            self._executor.wake()

    def run_due(self) -> None:
        """Run the callback that was due and did not run."""
        if self._task is not None and not self._task.executing():
            self._task()

    def close(self) -> None:
        """End the executor, and the callback that was due and did not run."""
        if self._task is not None and not self._task.executing():
            self._task.cancel()  # else Python warns of it in the component's log
        self._executor.shutdown()

    def _woken(self) -> bool:
        return self._is_woken


def _why_ended(error: Exception) -> str:
    if type(error).__name__ == "InvalidHandle":
        what = "(`destroy_node` or `rclpy.shutdown`)"
        return f"its ROS 2 node was destroyed {what}: no callback runs"
    return f"its ROS 2 executor ended: {error!r}"


def _run(task: Any) -> None:  # noqa: ANN401, a task of rclpy
    task()
    error = task.exception()
    if error is not None:
        raise error


def _what(entity: Any) -> str:  # noqa: ANN401, an entity of a node
    for name in ("topic_name", "srv_name", "service_name"):
        if (found := getattr(entity, name, None)) is not None:
            return str(found)
    return type(entity).__name__.lower()
