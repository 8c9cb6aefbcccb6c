"""The stubs of native modules say what the modules are."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

stubgen = pytest.importorskip("nanobind.stubgen")
SOURCE = Path(__file__).parents[1] / "src"
MODULES = (
    "poise.plan._core",
    "poise.estimate._change_point",
    "poise.runtime._calls",
    "poise.simulation._engine",
    "poise.wire._channel",
)


def generated(name: str) -> str:
    left_out = stubgen.load_pattern_file(str(SOURCE.parent / ".ci/stubs.txt"))
    stub = stubgen.StubGen(importlib.import_module(name), patterns=left_out)
    stub.put(stub.module)
    return str(stub.get())


def committed(name: str) -> str:
    return (SOURCE / f"{name.replace('.', '/')}.pyi").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_a_stub_is_generated(name: str) -> None:
    """Made anew by ``make stubs``."""
    text = generated(name)
    for action in (["check", "--fix", "--exit-zero"], ["format"]):
        ruff = [sys.executable, "-m", "ruff", *action, "-q", "-"]
        stub = ["--stdin-filename", str(SOURCE / f"{name.replace('.', '/')}.pyi")]
        text = subprocess.run(
            [*ruff, *stub], input=text, capture_output=True, text=True, check=True
        ).stdout
    assert ast.dump(ast.parse(committed(name))) == ast.dump(ast.parse(text))
