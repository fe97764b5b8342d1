"""Hooks of the documentation's site (mkdocs.yml): navigation from the folders, and links that lead out of docs/."""

import re
from pathlib import Path
from posixpath import join, normpath
from typing import Any

HOME = Path(__file__).parent
FOLDERS = {"Benchmarks": "benchmarks", "Decisions": "decisions"}
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(((?!\w+:)[^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: Any) -> Any:
    """Every page of the folders has its place; one that nobody gave a place stands under More, so that none is lost."""
    for title, folder in FOLDERS.items():
        names = sorted(path.name for path in (HOME / folder).glob("*.md"))
        config.nav.append({title: [f"{folder}/{name}" for name in sorted(names, key=lambda name: (name != "README.md", name))]})
    named = set(re.findall(r"[\w/.-]+\.md", str(config.nav)))
    more = sorted(path.name for path in HOME.glob("*.md") if path.name not in named)
    if more:
        config.nav.append({"More": more})
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to source files, which are not part of the site, become their names."""

    def inner(match: re.Match[str]) -> str:
        target = normpath(join(Path(page.file.src_uri).parent.as_posix(), match[2]))
        return f"{match[1]} (`{target.removeprefix('../')}`)" if target.startswith("..") else match[0]

    return LINK.sub(inner, markdown)
