"""Errors that users' code lets out: told by its own lines, and not too often."""

from __future__ import annotations

import os
import traceback
from concurrent.futures import Future
from pathlib import Path

import pytest

import poise
from poise.errors import AGAIN, CalleeError, RobotError
from poise.runtime.component.error_report import (
    MOST_DISTINCT,
    Errors,
    brief_traceback,
    traceback_of,
)
from poise.runtime.connectors.route import raise_callee_error
from poise.wire import frame

ROBOT = "/robot/code.py"
OURS = f"{Path(poise.__file__).parent}/somewhere.py"


def raised(code: str, file: str = ROBOT, **names: object) -> Exception:
    """Return what code raises that lies in `file`, without the lines of this test."""
    try:
        exec(compile(code, file, "exec"), names)
    except Exception as error:  # noqa: BLE001, whatever it is
        return error.with_traceback(error.__traceback__ and error.__traceback__.tb_next)
    raise AssertionError(code)


def test_lines_and_causes_that_lie_in_poise_are_left_out() -> None:
    decode = "from poise.wire.codec import codec\ncodec(str).decode(b'x', b'')\n"
    error = raised(decode)
    assert "wire/codec.py" in "".join(traceback.format_exception(error))
    assert traceback_of(error).splitlines() == [
        "Traceback (most recent call last):",
        f'  File "{ROBOT}", line 2, in <module>',
        f"poise.wire.codec.WireError: {error}",
    ]


def test_a_cause_in_users_code_is_told() -> None:
    said = traceback_of(
        raised(
            "try:\n    1 / 0\nexcept ZeroDivisionError as error:\n"
            "    raise ValueError('no') from error\n"
        )
    )
    assert "ZeroDivisionError: division by zero" in said
    assert said.endswith("ValueError: no")


def test_what_poise_says_itself_needs_no_traceback() -> None:
    error = raised("raise E('no such class')", OURS, E=RobotError)
    assert traceback_of(error) == "no such class"


def test_what_poise_says_in_another_thread_needs_no_traceback_either() -> None:
    failed = Future[None]()
    failed.set_exception(RobotError("no such class"))
    error = raised("failed.result()", OURS, failed=failed)
    assert traceback_of(error) == "no such class"


def test_a_fault_of_poise_keeps_its_traceback() -> None:
    assert OURS in traceback_of(raised("1 / 0", OURS))


def test_a_callers_error_says_where_the_callee_raised() -> None:
    error = raised("fail(error)", fail=raise_callee_error, error=raised("[][3]"))
    assert isinstance(error, CalleeError)
    assert error.traceback.count(ROBOT) == 1
    assert traceback_of(error).count(ROBOT) == 2


def test_any_text_of_an_error_can_be_sent() -> None:
    error = raised("raise ValueError(text)", text=os.fsdecode(b"map-\xff.png"))
    with pytest.raises(CalleeError) as caught:
        raise_callee_error(error)
    assert caught.value.message == "map-\\udcff.png"
    frame.failure("ValueError", str(error), caught.value.traceback)
    assert "map-\\udcff.png" in traceback_of(error)
    assert "map-\\udcff.png" in brief_traceback(error)


def test_what_comes_again_and_again_is_logged_now_and_then(
    caplog: pytest.LogCaptureFixture,
) -> None:
    errors, error = Errors("camera"), raised("1 / 0")
    for number in range(1000):
        errors.note("shoot", error, now=number * 0.001)
    errors.note("shoot", raised("[][3]"), now=1.0)
    errors.note("cool", error, now=1.0)
    errors.note("shoot", error, now=AGAIN)
    assert [message.split(":")[0] for message in caplog.messages] == [
        "shoot",
        "shoot",
        "cool",
        "shoot (999 more like it since the last)",
    ]
    assert {record.name for record in caplog.records} == {"poise.component.camera"}
    assert errors.count == 1003
    assert errors.last.endswith("ZeroDivisionError: division by zero")


def test_what_poise_says_itself_for_two_reasons_is_counted_apart() -> None:
    errors = Errors("one")
    for lines in ("", "\n"):
        error = raised(f"{lines}raise E('refused')", OURS, E=RobotError)
        errors.note("checkpoint", error, 0.0)
        errors.note("checkpoint", error, 0.0)
    assert [error.count for error in errors.counts()] == [2, 2]


def test_errors_of_one_line_are_counted_together_and_not_without_end() -> None:
    errors = Errors("camera")
    for _ in range(3):
        errors.note("tick", raised("1 / 0"), 0.0)
    errors.note("tock", raised("1 / 0"), 0.0)
    assert [(e.where, e.count) for e in errors.counts()] == [("tick", 3), ("tock", 1)]
    for number in range(2 * MOST_DISTINCT):
        errors.note(f"timer_{number}", raised("1 / 0"), 0.0)
    assert len(errors.counts()) == MOST_DISTINCT
    assert sum(e.count for e in errors.counts()) == errors.count
