"""`up --record` keeps the recording before: it may be of what broke."""

from __future__ import annotations

from pathlib import Path

import pytest

from poise.errors import UsageError
from poise.session.up import _recorder


def test_the_recording_before_stays_beside_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    for _ in range(2):
        _recorder(path, "r").close()
        assert path.stat().st_size
    assert (tmp_path / "run-before.mcap").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_one_that_cannot_be_renamed_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()
    (tmp_path / "run-before.mcap").mkdir()
    with pytest.raises(UsageError, match="cannot be renamed: Is a directory"):
        _recorder(path, "r")
