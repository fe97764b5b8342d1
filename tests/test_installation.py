"""What `requirements/constraints.txt` pins goes onto the least release of each Python that the project names."""

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.specifiers import SpecifierSet
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
MINORS = [Version(f"3.{minor}.0") for minor in range(8, 30)]


def pythons() -> list[Version]:
    """The first release of each minor version of Python that `pyproject.toml` allows: Debian and others keep early ones."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [version for version in MINORS if version in SpecifierSet(project["requires-python"])]


def refusing(package: metadata.Distribution) -> list[str]:
    """The Pythons of the project that a package cannot be installed on."""
    allowed = SpecifierSet(package.metadata.get("Requires-Python") or "")
    return [str(version) for version in pythons() if version not in allowed]


def test_every_package_of_an_installation_goes_onto_every_python_of_the_project() -> None:
    assert [str(version) for version in pythons()] == ["3.11.0", "3.12.0", "3.13.0"]
    packages = list(metadata.distributions())
    assert len(packages) > 50
    refused = {f"{one.metadata['Name']} {one.version}": refusing(one) for one in packages}
    assert {name: versions for name, versions in refused.items() if versions} == {}
