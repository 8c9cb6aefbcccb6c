"""The stubs of native modules say what the modules are."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

stubgen = pytest.importorskip("nanobind.stubgen")
SOURCE = Path(__file__).parents[1] / "src"
GENERATED = ("poise.plan._core", "poise.runtime._calls", "poise.wire._channel")


def generated(name: str) -> str:
    stub = stubgen.StubGen(importlib.import_module(name))
    stub.put(stub.module)
    return str(stub.get())


def committed(name: str) -> str:
    return (SOURCE / f"{name.replace('.', '/')}.pyi").read_text(encoding="utf-8")


def names(stub: str) -> set[str]:
    """Return every class, attribute, function and its parameters, by name."""
    found = set()
    for node in ast.walk(ast.parse(stub)):
        owner = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
        if owner:
            found.add(owner)
        for item in node.body if isinstance(node, ast.Module | ast.ClassDef) else ():
            if isinstance(item, ast.AnnAssign):
                name = ast.unparse(item.target)
                if not name.startswith("__"):
                    found.add(f"{owner}{name}")
            elif isinstance(item, ast.FunctionDef):
                given = [*item.args.posonlyargs, *item.args.args, *item.args.kwonlyargs]
                parameters = ", ".join(a.arg for a in given if a.arg != "self")
                is_property = bool(item.decorator_list)
                call = "" if is_property else f"({parameters})"
                if not item.name.startswith("__"):  # made in other ways, too
                    found.add(f"{owner}{item.name}{call}")
    return found


@pytest.mark.parametrize("name", ["poise.estimate._change_point"])
def test_a_stub_names_what_the_module_has(name: str) -> None:
    assert names(committed(name)) == names(generated(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", GENERATED)
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
