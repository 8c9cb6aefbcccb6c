"""The entry of `poise`: runs a command, and ends it by its error or a signal."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn, Self, cast

if TYPE_CHECKING:
    from types import TracebackType

    from poise.errors import PoiseError


def run_process() -> None:
    """Run the command line as all that this process does."""
    try:
        main()
    except SystemExit as ended:
        from poise.threads import is_any_abandoned  # not before `end_at_once`

        if is_any_abandoned() and isinstance(ended.code, int | None):
            os._exit(ended.code or 0)  # the interpreter would wait for it
        raise


def main() -> None:
    """Run the command line; docs/command-line.md says the exit codes."""
    end_at_once()  # before anything is imported that takes long
    _open_closed()
    if isinstance(sys.stdout, TextIOWrapper):
        # what its encoding lacks, or is no text, is no reason to fail
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            _run(sys.argv[1:])
        finally:
            _flush()
    except BrokenPipeError:
        # The reader, such as `head`, has seen enough.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        from poise.errors import RunError

        is_disk_full = error.errno in {errno.ENOSPC, errno.EDQUOT}
        if error.filename is None and not is_disk_full:
            raise
        _fail(RunError(f"{error.filename or 'a result'}: {error.strerror}"), 1)
    except RuntimeError as error:
        from poise.errors import RunError
        from poise.threads import explained

        why = explained(error)
        if not isinstance(why, RunError):
            raise
        _fail(why, why.exit_code)


def _open_closed() -> None:
    """Let what goes to a stream that the caller closed be lost."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # else the next file or socket has its number
            setattr(sys, name, Path(os.devnull).open("r+"))  # noqa: SIM115


def _flush() -> None:
    """Write out what was printed; at Python's end nobody handles what this raises."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise


def _run(words: list[str]) -> NoReturn:
    import typer

    from poise.cli.command_table import build, check_words
    from poise.errors import PoiseError, UsageError

    completed = _completed()
    # all that typer raises for arguments that it refuses has this base
    misuse = cast("tuple[type[typer.BadParameter], ...]", typer.BadParameter.__bases__)
    try:
        if not completed:
            check_words(words)
        app = build(completed or words, completes=bool(completed))
        sys.exit(app(prog_name="poise", standalone_mode="--json" not in words))
    except misuse as error:
        _fail(UsageError(error.format_message()), 2)
    except PoiseError as error:
        _fail(error, error.exit_code)
    finally:
        sys.excepthook = _say_traceback  # in place of typer's


def _completed() -> list[str]:
    """Return the words after `poise` that a shell asks to complete, if one does."""
    if "_POISE_COMPLETE" not in os.environ:
        return []
    by_bash = os.environ.get("COMP_WORDS", "")
    return os.environ.get("_TYPER_COMPLETE_ARGS", by_bash).split()[1:]


def _fail(error: PoiseError, code: int) -> NoReturn:
    _say_last(str(error))
    if "--json" in sys.argv:
        _print_error(error)
    sys.exit(code)


def _say_last(text: str) -> None:
    """Print to stderr; drop what is not taken within a second or two.

    A command whose stderr is a full pipe that nobody reads would hang for ever.
    """
    from poise.session.launch.printer import Printer

    try:
        with Printer(sys.stderr.fileno()) as printer:
            printer.print(text)
    except RuntimeError:  # no thread is free
        sys.stderr.write(f"{text}\n")


def _say_traceback(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    import traceback

    _say_last("".join(traceback.format_exception(kind, error, trace)).rstrip())


def _print_error(error: PoiseError) -> None:
    import json

    import msgspec

    from poise.errors import RobotError

    problems = error.problems if isinstance(error, RobotError) else ()
    answer = {
        "error": str(error),
        "kind": type(error).__name__,
        "problems": msgspec.to_builtins(problems),
    }
    with contextlib.suppress(OSError):  # stderr has it
        sys.stdout.write(json.dumps(answer) + "\n")


_SHOW_CURSOR = b"\x1b[?25h"
"""Makes a terminal's cursor visible, which spinners and bars hide."""
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def end_at_once() -> None:
    """Let each signal end this process with its exit code: nothing has begun.

    SIGHUP stays ignored where it is, as under `nohup`.
    """
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, _frame: FrameType | None) -> None:
    if os.isatty(2):
        os.write(2, _SHOW_CURSOR)
    os._exit(128 + number)


class Interrupts:
    """Notes signals inside its ``with`` block, at whose end the command ends.

    `check` raises KeyboardInterrupt where the command waits. A second signal does
    nothing, as it must not cut clean-up short.
    """

    def __init__(self) -> None:
        self.number = 0

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self.number:
            raise KeyboardInterrupt

    def has_come(self) -> bool:
        """Return whether a signal came."""
        return self.number != 0

    def __enter__(self) -> Self:
        self._before = {number: signal.getsignal(number) for number in _ENDING}
        for number, handler in self._before.items():
            if handler != signal.SIG_IGN:
                signal.signal(number, self._note)
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self.number:
            raise SystemExit(128 + self.number) from error

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.number = self.number or number
