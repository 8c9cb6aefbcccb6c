"""Runs `poise` as users do."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from poise.cli.main import main
from tests.busy import CpuOfOthers, skip_as_starved
from tests.waiting import LONG

POISE = (sys.executable, "-m", "poise")
STARVED = "this machine was too busy to give the emulated computers"
OUTPUT_SCHEMA = Path(__file__).parents[1] / "docs/output.schema.json"
_BY_LINE = {"echo", "hz", "log"}
_STARTING = {"agent", "calibrate", "demo", "profile", "run", "up"}
"""Commands that start robots."""

Poise = Callable[..., subprocess.CompletedProcess[str]]


@functools.cache
def _validator(command: str) -> Any:
    definitions = json.loads(OUTPUT_SCHEMA.read_text())["$defs"]
    of_command = {"$defs": definitions, **definitions[command]}
    return jsonschema.Draft202012Validator(of_command)


def check_output(words: Sequence[str], text: str) -> None:
    """Raise ValidationError if a command printed other JSON than is published."""
    with_sub_command = " ".join(words[:2])
    names = json.loads(OUTPUT_SCHEMA.read_text())["$defs"]
    command = with_sub_command if with_sub_command in names else words[0]
    for each in text.splitlines() if command in _BY_LINE else [text]:
        _validator(command).validate(json.loads(each))


def run_poise(
    *words: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return what it said and its exit code.

    What starts a robot is a process of its own; to start one for what only asks would
    take longer than to ask. Skip the test when it says that the host starved the
    emulated computers, and others did use the host.
    """
    others = CpuOfOthers()
    texts = [str(word) for word in words]
    is_starting = texts[0] in _STARTING and not {
        "show",
        "install",
        "uninstall",
        "-h",
    } & {*texts}
    done = (_started if is_starting else called)(texts, cwd)
    if "--json" in texts and done.stdout:
        check_output(texts, done.stdout)
    for line in (done.stdout + done.stderr).splitlines():
        if done.returncode and STARVED in line:
            skip_as_starved(line, others)
    return done


def _started(
    words: Sequence[str], cwd: Path | None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*POISE, *words],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )


def called(
    words: Sequence[str], cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process."""
    out = io.StringIO()
    with (
        tempfile.TemporaryFile("w+", buffering=1) as err,
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        contextlib.chdir(cwd or Path.cwd()),
        _handlers_kept(),
    ):
        patch.setattr(sys, "argv", ["poise", *words])
        code = _exit_code(main)
        err.seek(0)
        said = err.read()
    return subprocess.CompletedProcess(words, code, out.getvalue(), said)


@contextlib.contextmanager
def _handlers_kept() -> Iterator[None]:
    """Restore what signals do in this process, which a command changes."""
    ending = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    handlers = [(number, signal.getsignal(number)) for number in ending]
    try:
        yield
    finally:
        for number, handler in handlers:
            signal.signal(number, handler)


def _exit_code(call: Callable[[], object]) -> int:
    try:
        call()
    except SystemExit as ended:
        return int(ended.code or 0)
    pytest.fail("a command ends its process")


@contextlib.contextmanager
def robot_up(file: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """Start a robot; end it afterwards, whether or not somebody did."""
    argv = [*POISE, "up", str(file), *map(str, options)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert any("is up" in line for line in process.stdout)
            yield process
        finally:
            process.terminate()
            process.communicate(timeout=LONG)
