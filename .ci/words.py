"""Find words that must not come back: ``python .ci/words.py``.

`words.toml` says which, what to say instead, and what is excepted for which reason.
A *name* is what Python code calls a thing; a *phrase* is text of any tracked file:
documents, messages, docstrings, comments. A *message* is a string of the code of
`src`, but no docstring. A file's name stands once in `src`: it says what it holds.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def names_in(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of all that a module defines or assigns."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name):
                yield node.lineno, name
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield node.lineno, name
            case ast.ClassDef(name=name) | ast.MatchAs(name=str(name)):
                yield node.lineno, name
            case ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name


def wrong_names(text: str, names: Mapping[str, str]) -> Iterator[tuple[int, str, str]]:
    """Yield line, name and way out of names that must not come back."""
    for line, name in names_in(ast.parse(text)):
        bare = name.strip("_")
        if bare in names:
            yield line, name, names[bare]


def wrong_phrases(
    text: str, phrases: Mapping[str, str]
) -> Iterator[tuple[int, str, str]]:
    """Yield line, phrase and way out; a phrase may go over the end of a line."""
    for phrase, instead in phrases.items():
        pattern = r"\b" + phrase.replace(" ", r"[\s#*]+") + r"\b"
        for found in re.finditer(pattern, text, re.IGNORECASE):
            line = text.count("\n", 0, found.start()) + 1
            yield line, " ".join(found[0].split()), instead


def messages_in(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of all strings of a module that are no docstrings."""
    said = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        match node:
            case ast.Constant(value=str(text)) if id(node) not in said:
                yield node.lineno, text


def wrong_messages(
    text: str, messages: Mapping[str, str]
) -> Iterator[tuple[int, str, str]]:
    """Yield line, phrase and way out of messages that need other words."""
    for line, message in messages_in(ast.parse(text)):
        for _, phrase, instead in wrong_phrases(message, messages):
            yield line, phrase, instead


def is_excepted(file: str, word: str, exceptions: Sequence[Mapping[str, str]]) -> bool:
    """Return whether a word may stand in a file."""
    return any(
        file.startswith(exception["in"]) and word.lower() == exception["word"]
        for exception in exceptions
    )


def tracked(folders: Sequence[str], endings: Sequence[str]) -> list[str]:
    """Return the files under version control."""
    listing = subprocess.run(
        ["git", "ls-files", "--", *folders],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return [
        file for file in listing.stdout.splitlines() if file.endswith(tuple(endings))
    ]


def problems(words: Mapping[str, Any], files: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each word that must not stand where it does."""
    for file in files:
        text = (ROOT / file).read_text(encoding="utf-8")
        wrong = list(wrong_phrases(text, words["phrases"]))
        if file.endswith(".py"):
            wrong += wrong_names(text, words["names"])
            if file.startswith("src/"):
                wrong += wrong_messages(text, words["messages"])
        for line, word, instead in wrong:
            if not is_excepted(file, word, words["exceptions"]):
                yield f"{file}:{line}: {word!r}: say {instead}"


def repeated_names(files: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each name that several modules have."""
    modules = [
        file for file in files if file.startswith("src/") and file.endswith(".py")
    ]
    counts = Counter(Path(file).name for file in modules)
    for file in modules:
        name = Path(file).name
        if counts[name] > 1 and name != "__init__.py":
            yield f"{file}: another file has this name, too"


def main() -> None:
    """Print all that is wrong; exit with 1 if anything is."""
    words = tomllib.loads((ROOT / ".ci/words.toml").read_text(encoding="utf-8"))
    files = tracked(words["folders"], words["endings"])
    found = [*problems(words, files), *repeated_names(files)]
    print("\n".join(found) or "words: no problems")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
