"""The generated pages of the documentation site: commands, keys, Python names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import poise
from poise.cli.command_table import COMMANDS, build

DOCS = Path(__file__).parents[1]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, before links are checked."""
    pages = {
        "commands": commands(),
        "robot-keys": keys("The keys of a robot file", "robot.schema.json"),
        "python": names(),
    }
    for name, text in pages.items():
        path = f"docs/reference/{name}.md"
        files.append(File.generated(config, path, content=text))
    return files


def commands() -> str:
    """Return the help of every command, as `poise COMMAND --help` has it."""
    parts = ["# All commands", ""]
    for name in COMMANDS:
        words = name.split()
        command = typer.main.get_command(build(words))
        for word in words:
            command = command.commands[word]
        context = typer.Context(command, info_name=f"poise {name}")
        about, _, examples = (command.help or "").partition("Example")
        examples = re.sub(r"^s?:?\s*(--------)?\s*", "", examples)
        parts += [f"## poise {name}", "", about.strip(), ""]
        if examples:
            parts += ["```sh", re.sub(r"\n\s*\n", "\n", examples.strip()), "```", ""]
        parts += ["| argument | |", "| --- | --- |"]
        for parameter in command.params:
            record = parameter.get_help_record(context)
            if isinstance(parameter, typer.core.TyperArgument):
                record = ((parameter.name or "").upper(), parameter.help or "")
            if record:
                head, text = (cell.replace("|", "\\|") for cell in record)
                parts.append(f"| `{head}` | {text} |")
        parts.append("")
    return "\n".join(parts)


def keys(title: str, schema: str) -> str:
    """Return the keys of a file as tables, one for each kind of section."""
    whole: dict[str, Any] = json.loads((DOCS / schema).read_text())
    parts = [f"# {title}", "", f"From [its JSON Schema](../{schema}).", ""]
    parts += section("The file", whole)
    for name, part in whole.get("$defs", {}).items():
        parts += section(name, part)
    return "\n".join(parts)


def section(name: str, part: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of one kind of section."""
    if "properties" not in part:
        return
    yield from (f"## {name}", "", part.get("description", ""), "")
    yield from ("| key | value | is |", "| --- | --- | --- |")
    for key, value in part["properties"].items():
        needed = " (needed)" if key in part.get("required", ()) else ""
        text = value.get("description", "").replace("|", "\\|").replace("\n", " ")
        yield f"| `{key}`{needed} | {kind(value)} | {text} |"
    yield ""


def kind(value: Mapping[str, Any]) -> str:
    """Return what a value is, with a link to the table of its kind."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "enum" in value:
        return ", ".join(f"`{each}`" for each in value["enum"])
    for several in ("anyOf", "oneOf"):
        if several in value:
            return " or ".join(dict.fromkeys(map(kind, value[several])))
    if isinstance(value.get("items"), dict):
        return f"list of {kind(value['items'])}"
    extra = value.get("additionalProperties")
    if isinstance(extra, dict):
        return f"name: {kind(extra)}"
    found = value.get("type", "any")
    return found if isinstance(found, str) else " or ".join(found)


def names() -> str:
    """Return a page on each public name of `poise`, from its docstring."""
    parts = ["# All Python names", ""]
    for name in sorted(dir(poise)):
        if not name.startswith("_"):
            parts += [f"::: poise.{name}", ""]
    return "\n".join(parts)
