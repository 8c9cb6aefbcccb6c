"""The generated pages of the documentation site: what code and schemas say."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import poise
from poise.cli.command_table import COMMANDS, build
from poise.model.file_keys import keys_of
from poise.model.policy import SUBJECTS

DOCS = Path(__file__).parents[1]
GENERATED = {
    "../src/poise/model/policy.py": "reference/policy-values.md",
    "output.schema.json": "reference/json.md",
    "problem.schema.json": "reference/problem-keys.md",
    "robot.schema.json": "reference/robot-keys.md",
}
"""What pages link to in the repository -> the page that the site has for it."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, before links are checked."""
    pages = {
        "commands": commands(),
        "json": keys("What commands print with --json", "output.schema.json"),
        "policy-values": values(),
        "problem-keys": keys("The keys of a problem file", "problem.schema.json"),
        "python": names(),
        "robot-keys": keys("The keys of a robot file", "robot.schema.json"),
    }
    for name, text in pages.items():
        path = f"docs/reference/{name}.md"
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Let links to schemas lead to the pages that are generated from them."""
    if not page.file.src_uri.startswith("docs/reference/"):
        for link, generated in GENERATED.items():
            markdown = markdown.replace(f"]({link})", f"]({generated})")
    return markdown


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
        if "anyOf" in part:  # what a command prints
            yield from (f"## poise {name}", "", kind(part), "")
        return
    about, said = fields(part.get("description", ""))
    yield from (f"## {name}", "", about, "")
    yield from ("| key | value | default | |", "| --- | --- | --- | --- |")
    for key, value in part["properties"].items():
        text = cell(value.get("description") or said.get(key, ""))
        yield f"| `{key}` | {kind(value)} | {default(part, key)} | {text} |"
    yield ""


def default(part: Mapping[str, Any], key: str) -> str:
    """Return what a key is when it is not written."""
    if key in part.get("required", ()):
        return "required"
    value = part["properties"][key].get("default")
    plain_value = isinstance(value, bool | int | float | str) and value != ""
    return f"`{value}`" if plain_value else ""


def fields(docstring: str) -> tuple[str, Mapping[str, str]]:
    """Split a docstring in NumPy form into its text and what it says of fields."""
    about, *sections = re.split(r"\n *\w+\n *-{4,}\n", docstring)
    said: dict[str, str] = {}
    for each in sections:
        indent = len(each) - len(each.lstrip(" "))
        for names, text in re.findall(
            rf"^ {{{indent}}}(\S.*)\n((?: {{{indent + 1},}}\S.*\n?)+)",
            each,
            re.MULTILINE,
        ):
            said |= dict.fromkeys(names.partition(" : ")[0].split(", "), text)
    return cell(about), said


def cell(text: str) -> str:
    """Return a text as it fits into a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def values() -> str:
    """Return the values that conditions of policies may have, by subject."""
    parts: list[str] = ["# The values of policies", ""]
    for subject, record in SUBJECTS.items():
        about = (record.__doc__ or "").strip().splitlines()[0]
        parts += [f"## {subject}", "", about, ""]
        parts += ["| value | unit or kind | |", "| --- | --- | --- |"]
        for name, key in keys_of(record).items():
            notes = key.kind.extra or {}
            unit = (
                notes["dimension"].name
                if "dimension" in notes
                else plain(key.kind.type)
            )
            parts.append(f"| `{name}` | {unit} | {cell(notes['says'])} |")
        parts.append("")
    return "\n".join(parts)


def plain(type_: msgspec.inspect.Type) -> str:
    """Return the word for a type without a unit."""
    if isinstance(type_, msgspec.inspect.LiteralType):
        return ", ".join(f"`{value}`" for value in type_.values)
    return {"BoolType": "truth value", "IntType": "number"}.get(
        type(type_).__name__, "text"
    )


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
