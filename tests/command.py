"""Runs `poise` as users do."""

from __future__ import annotations

import contextlib
import functools
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jsonschema

from tests.busy import skip_as_busy
from tests.waiting import LONG

POISE = (sys.executable, "-m", "poise")
STARVED = "this machine was too busy to give the emulated computers"
OUTPUT_SCHEMA = Path(__file__).parents[1] / "docs/output.schema.json"
_BY_LINE = {"echo", "hz", "log"}

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

    Skip the test when it says that the host starved the emulated computers.
    """
    done = subprocess.run(
        [*POISE, *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    if "--json" in words and done.stdout:
        check_output([str(word) for word in words], done.stdout)
    for line in done.stderr.splitlines():
        if done.returncode and STARVED in line:
            skip_as_busy(line)
    return done


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
