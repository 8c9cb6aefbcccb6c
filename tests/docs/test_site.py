"""What the documentation site generates says what the code says."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from poise.cli.command_table import COMMANDS
from poise.model.policy import SUBJECTS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    pytest.importorskip("mkdocs", reason="needs the extra 'docs'")
    spec = importlib.util.spec_from_file_location("pages", ROOT / "docs/site/pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_command_has_a_section(pages: ModuleType) -> None:
    text = pages.commands()
    assert [name for name in COMMANDS if f"\n## poise {name}\n" not in text] == []


def test_keys_have_value_default_and_meaning(pages: ModuleType) -> None:
    text = pages.keys("Keys", "robot.schema.json")
    assert "| `price` | number | `1.0` | What it costs, in any unit;" in text
    assert "| `memory` | number or string | required | Its memory" in text


def test_what_commands_print_is_described_by_the_docstrings(pages: ModuleType) -> None:
    text = pages.keys("JSON", "output.schema.json")
    assert "## poise run\n\n[RunReport](#runreport) or [Failed](#failed)" in text
    assert "| `hung` | list of [HungHandler](#hunghandler) |  | Handlers that" in text


def test_values_of_policies_have_units(pages: ModuleType) -> None:
    text = pages.values()
    assert [s for s in SUBJECTS if f"\n## {s}\n" not in text] == []
    assert "| `capacity` | number of cores | The CPU that it has. |" in text
    assert "| `lost` | truth value | Whether it is out of reach. |" in text
    assert "| `name` | text | Its name. |" in text


def test_links_to_schemas_lead_to_generated_pages(pages: ModuleType) -> None:
    page = SimpleNamespace(file=SimpleNamespace(src_uri="docs/policies.md"))
    said = pages.on_page_markdown("see [keys](robot.schema.json)", page, files=None)
    assert said == "see [keys](reference/robot-keys.md)"
    assert all((ROOT / "docs" / link).exists() for link in pages.GENERATED)
