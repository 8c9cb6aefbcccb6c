"""Writes values into a robot file and keeps its comments and layout. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping

from poise.model.yaml.tree import Location, Path, Positions

_VALUE = r"(\s*:\s*)(\"[^\"]*\"|'[^']*'|[^,}#\n]*?)(?=\s*(?:[,}#]|$))"


def with_values(
    texts: Mapping[str, str],
    positions: Positions,
    path: Path,
    values: Mapping[str, str],
) -> dict[str, str]:
    """Return the files' texts with `values` under the mapping at `path`.

    An existing key gets the new value in place. New keys are inserted before the first
    key of the mapping, in the same style.
    """
    lines = {file: text.splitlines(keepends=True) for file, text in texts.items()}
    first = positions.first_key(path)
    here = positions.at(path)
    new = {k: v for k, v in values.items() if not positions.has((*path, k))}
    # from right to left, so that the remaining locations stay valid
    kept = [(positions.at((*path, key)), key) for key in values if key not in new]
    for place, key in sorted(kept, key=lambda each: -each[0].column):
        _replace(lines, place, key, values[key])
    _insert(lines, first, new, is_flow=first.line == here.line)
    return {file: "".join(each) for file, each in lines.items()}


def _replace(lines: dict[str, list[str]], at: Location, key: str, value: str) -> None:
    line = lines[at.file][at.line - 1]
    head, tail = line[: at.column - 1], line[at.column - 1 :]
    pattern = rf"(\"{key}\"|'{key}'|{key}){_VALUE}"
    found = re.sub(pattern, lambda m: f"{m[1]}{m[2]}{value}", tail, count=1)
    lines[at.file][at.line - 1] = head + found


def _insert(
    lines: dict[str, list[str]],
    first: Location,
    new: Mapping[str, str],
    *,
    is_flow: bool,
) -> None:
    index, column = first.line - 1, first.column - 1
    line = lines[first.file][index]
    if is_flow:
        added = "".join(f"{key}: {value}, " for key, value in new.items())
        lines[first.file][index] = line[:column] + added + line[column:]
    else:
        added = "".join(f"{' ' * column}{k}: {v}\n" for k, v in new.items())
        lines[first.file].insert(index, added)
