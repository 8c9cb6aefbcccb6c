"""A file that is written at the end is whole, or is what it was."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from poise.cli.options import try_write
from poise.errors import RunError
from poise.model import load
from poise.session.agent_service import AgentService
from poise.session.diagrams.draw import draw
from poise.session.folders import write_whole

HELLO = Path(__file__).parents[2] / "examples" / "hello" / "robot.yaml"


def disk_is_full(path: Path, *_: object, **__: object) -> int:
    path.open("w").close()
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_leaves_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, drawing, said = tmp_path / "page.html", tmp_path / "robot.svg", list[str]()
    page.write_text("earlier")
    drawing.write_text("earlier")
    monkeypatch.setattr(Path, "write_text", disk_is_full)
    assert not try_write(page, "later", said.append)
    assert said == [f"{page} cannot be written: No space left on device"]
    with pytest.raises(RunError, match=r"robot\.svg cannot be written: No space"):
        draw(load(HELLO)).save(drawing)
    service = AgentService("hello", "left", is_users=False, folder=tmp_path)
    with pytest.raises(RunError, match=r"left\.service cannot be written: No space"):
        service.install("")
    assert {path.read_text() for path in tmp_path.iterdir()} == {"earlier"}
    assert set(tmp_path.iterdir()) == {page, drawing}


def test_a_pipe_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDWR)
    try:
        write_whole(pipe, "text")
        assert os.read(reader, 100) == b"text"
    finally:
        os.close(reader)
    assert pipe.is_fifo()
