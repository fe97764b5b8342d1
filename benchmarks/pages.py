"""Where the tables of the benchmarks go: pages of docs/, between two marks that bear the benchmark's name."""

from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"


def put_between_marks(page: Path, name: str, text: str) -> None:
    """Replace what stands in a page between the lines `<!-- name: begin -->` and `<!-- name: end -->` by text (Markdown).

    Raises ValueError where the page does not hold each mark once.
    """
    begin, end = (f"<!-- {name}: {which} -->\n" for which in ("begin", "end"))
    before, rest = page.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end)
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def between_marks(page: Path, name: str) -> str:
    """What stands between the marks. Raises ValueError where the page does not hold each mark once."""
    _, rest = page.read_text(encoding="utf-8").split(f"<!-- {name}: begin -->\n")
    text, _ = rest.split(f"<!-- {name}: end -->\n")
    return text.strip("\n")
