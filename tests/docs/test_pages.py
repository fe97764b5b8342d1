"""The pages of docs/ name what exists: linked pages, sections, pictures and source files."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
SOURCE = re.compile(r"`((?:[a-z_0-9]+/)+(?:[a-z_0-9]+\.py)?)`")
HOMES = ("core/wayloom", "services", "workers", ".")


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links() -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            if "://" not in target and not target.startswith("mailto:"):
                yield page, target


@pytest.mark.parametrize(("page", "target"), [pytest.param(*link, id=f"{link[0].name}-{link[1]}") for link in links()])
def test_a_link_leads_somewhere(page: Path, target: str) -> None:
    name, _, anchor = target.partition("#")
    place = page if not name else (page.parent / name).resolve()
    assert place.exists(), f"{page.name} links to {target}, which is not there"
    if anchor:
        assert anchor in anchors(place), f"{page.name} links to a section {anchor!r} that {place.name} does not have"


def is_there(name: str) -> bool:
    """Whether a file or folder of this name lies in one of the source roots, or, where a page speaks of one room, in a room."""
    return any((ROOT / home / name).exists() for home in HOMES) or any((ROOT / "core" / "wayloom").glob(f"*/{name}"))


@pytest.mark.parametrize("page", ["architecture.md", "glossary.md", "tour.md"])
def test_source_files_that_a_page_names_are_there(page: str) -> None:
    named = SOURCE.findall((ROOT / "docs" / page).read_text(encoding="utf-8"))
    assert named
    missing = [name for name in named if not is_there(name)]
    assert not missing


@pytest.mark.parametrize("page", [page for page in PAGES if re.match(r"\d{4}-", page.name)], ids=lambda page: page.stem)
def test_a_decision_is_headed_by_its_number_and_its_title(page: Path) -> None:
    assert re.match(rf"# {page.name[:4]} · \S", page.read_text(encoding="utf-8")), page.name
