"""Links between documents lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/**/*.md", "benchmarks/**/*.md")
    for path in ROOT.glob(pattern)
)


def anchors(document: Path) -> set[str]:
    """Return the names of a document's headings, as links call them."""
    titles = re.findall(r"^#+ (.+)$", document.read_text(), re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", title.lower()) for title in titles)
    return {title.replace(" ", "-") for title in kept}


def is_broken(document: Path, link: str) -> bool:
    name, _, anchor = link.partition("#")
    target = document.parent / name if name else document
    if not target.exists():
        return True
    return bool(anchor) and anchor not in anchors(target)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_leads_somewhere(document: Path) -> None:
    text = re.sub(r"```.*?```", "", document.read_text(), flags=re.DOTALL)
    links = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text)
    relative = [link for link in links if "://" not in link]
    assert [link for link in relative if is_broken(document, link)] == []


def test_every_document_can_be_found_from_the_map() -> None:
    index = (ROOT / "docs/index.md").read_text()
    pages = (ROOT / "docs").rglob("*.md")
    names = [str(page.relative_to(ROOT / "docs")) for page in pages]
    assert [n for n in names if n != "index.md" and f"({n})" not in index] == []


def test_every_document_is_in_the_sites_navigation() -> None:
    config = (ROOT / "docs/mkdocs.yml").read_text()
    pages = (str(page.relative_to(ROOT)) for page in (ROOT / "docs").rglob("*.md"))
    assert [page for page in pages if f": {page}\n" not in config] == []
