"""What an installation brings along may be used and handed on; `docs/licences.md` names it."""

import re
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PERMITTED = re.compile(r"MIT|BSD|Apache|Python Software Foundation|PSF|ISC|Mozilla|MPL|LGPL")


EXTRAS = ("oidc",)
"""What runs in the service when it is asked for, as if always asked for."""


def direct() -> list[Requirement]:
    """The dependencies of an installation on this machine, with the service's extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    texts = [*project["dependencies"], *(text for extra in EXTRAS for text in project["optional-dependencies"][extra])]
    found = [Requirement(text) for text in texts]
    return [one for one in found if one.marker is None or one.marker.evaluate({"extra": ""})]


def normal(name: str) -> str:
    return re.sub("[-_.]+", "-", name).lower()


def everything(wanted: list[Requirement]) -> dict[str, str]:
    """Package to licence, of the requirements and of what they require."""
    found: dict[str, str] = {}
    met: set[tuple[str, frozenset[str]]] = set()
    while wanted:
        requirement = wanted.pop()
        name, extras = normal(requirement.name), frozenset({"", *requirement.extras})
        if (name, extras) in met:
            continue
        met.add((name, extras))
        package = metadata.distribution(name)
        found[name] = licence(package)
        needed = [Requirement(text) for text in package.requires or []]
        wanted += [one for one in needed if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras)]
    return found


def licence(package: metadata.Distribution) -> str:
    said = package.metadata
    classes = [text.rpartition("::")[2].strip() for text in said.get_all("Classifier") or [] if text.startswith("License")]
    return said.get("License-Expression") or "; ".join(classes) or str(said.get("License") or "").partition("\n")[0]


def test_no_dependency_of_a_dependency_is_under_the_gpl() -> None:
    found = everything(direct())
    assert len(found) > 50
    assert {name: text for name, text in found.items() if not PERMITTED.search(text)} == {}
    assert {name for name, text in found.items() if re.search(r"(?<![AL])GPL|GNU General|AGPL", text)} == set()


def test_the_licence_page_names_every_direct_dependency() -> None:
    page = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    assert [one.name for one in direct() if not re.search(rf"\b{re.escape(normal(one.name))}\b", page)] == []
