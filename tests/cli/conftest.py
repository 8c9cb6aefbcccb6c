"""What tests of commands name."""

from tests.command import Poise as Poise  # noqa: PLC0414, to be named from here
