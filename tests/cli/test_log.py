"""`poise log` says when it cannot show all."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import typer

from poise.cli import watch_command
from poise.cli.watch_command import log_command
from poise.manage.control_socket.commands import LogReading
from poise.wire.records.request_records import OutputLine


def log(monkeypatch: pytest.MonkeyPatch, *silent: tuple[str, ...]) -> None:
    """Show a log of which these computers gave no answer, one reading after another."""
    line = OutputLine(at=0, component="printer", text="one", computer="left")

    class Running:
        def __init__(self, name: str | None) -> None:
            self.name = name

        def log(self, *_: object, **__: object) -> Iterator[LogReading]:
            for each in silent:
                yield LogReading((line,), {}, silent=each)

    monkeypatch.setattr(watch_command, "Running", Running)
    log_command("printer", last=100, follow=False, robot=None, as_json=False)


def test_a_log_without_a_computer_that_did_not_answer_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as ended:
        log(monkeypatch, ("right",))
    assert ended.value.exit_code == 1
    said = capsys.readouterr()
    assert said.out.endswith(" printer@left: one\n")
    assert said.err == "# no answer from right\n"


def test_a_log_that_is_whole_in_the_end_is_a_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log(monkeypatch, ("right",), ())
    assert capsys.readouterr().err == "# no answer from right\n# all answer\n"
