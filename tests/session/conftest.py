"""Samples of a robot that works steadily, as those of the manager's tests."""

from tests.manage.observe.conftest import steady

__all__ = ["steady"]
