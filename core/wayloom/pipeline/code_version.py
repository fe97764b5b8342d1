"""Code version of a module: a digest of all that it imports of wayloom, and the versions of the libraries that make its numbers.

The transitive closure is found in the source, without importing anything: every `import` of a wayloom module, in functions too, but
not under TYPE_CHECKING. A file counts by its bytecode without docstrings and line numbers, so that a comment, a docstring or
a blank line changes no version. The package's own __init__ does not count: it says the version and prepares caches.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

import wayloom
from wayloom.errors import StageError
from wayloom.pipeline.parsed_source import ParsedSources, kept_sources

PACKAGE: Final = Path(wayloom.__file__).parent
LIBRARIES: Final[Mapping[str, tuple[str, ...]]] = {
    "numpy": ("numpy",),
    "numba": ("numba", "llvmlite"),
    "cv2": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "scipy": ("scipy",),
    "gtsam": ("gtsam",),
    "onnxruntime": ("onnxruntime", "onnxruntime-gpu", "onnxruntime-openvino"),
    "pyproj": ("pyproj",),
}
"""Import name of each library that makes numbers, and the distributions that may bring it or parts of it."""


@dataclass(frozen=True, slots=True)
class CodeVersion:
    """digest: hex, of the closure. modules: of wayloom in it, sorted. libraries: versions of those that it imports."""

    digest: str
    modules: tuple[str, ...]
    libraries: Mapping[str, str]

    @property
    def text(self) -> str:
        """The digest and the libraries in one line."""
        return " ".join([self.digest, *(f"{name}={number}" for name, number in self.libraries.items())])


@dataclass(frozen=True, slots=True)
class _Source:
    """A file: the digest of its code, the wayloom modules that it imports, the other packages that it imports."""

    digest: str
    modules: frozenset[str]
    packages: frozenset[str]


def code_version(module: str, package: Path = PACKAGE) -> CodeVersion:
    """The version of a module of the package `wayloom` that lies in the folder `package`, or of any other importable module.

    Raises StageError where there is no such module.
    """
    return _code_version(module, package)


@lru_cache
def _code_version(module: str, package: Path) -> CodeVersion:
    found: dict[str, _Source] = {}
    todo = {module}
    sources = _sources()
    while todo:
        name = todo.pop()
        found[name] = _source(name, package, sources)
        todo |= found[name].modules - found.keys()
    sources.keep()
    modules = tuple(sorted(found))
    digest = hashlib.sha256("".join(f"{name} {found[name].digest}\n" for name in modules).encode()).hexdigest()
    packages = frozenset().union(*(source.packages for source in found.values()))
    return CodeVersion(digest[:16], modules, library_versions(packages))


def library_versions(packages: frozenset[str]) -> dict[str, str]:
    """The installed version of each distribution of LIBRARIES whose import name is among `packages`; of pyproj, PROJ's data too."""
    names = sorted(name for package in packages if package in LIBRARIES for name in LIBRARIES[package])
    found = {name: number for name in names if (number := _installed(name)) is not None}
    if "pyproj" in packages:
        from wayloom.geodesy.wgs84 import proj_versions

        found |= proj_versions()
    return found


@lru_cache
def _installed(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


@lru_cache
def _sources() -> ParsedSources:
    return kept_sources()


def _source(name: str, package: Path, sources: ParsedSources) -> _Source:
    file = module_file(name, package)
    if file is None:
        raise StageError(f"no module {name} below {package.parent}: the catalogue of stages names it")
    source = sources.of(file.read_bytes())
    imported, packages = set[str](), set[str]()
    for module, names in source.imports:
        if module.split(".")[0] != "wayloom":
            packages.add(module.split(".")[0])
            continue
        imported |= {part for part in (module, *(f"{module}.{name}" for name in names)) if module_file(part, package) is not None}
    parents = {parent for part in {name, *imported} for parent in _parents(part)}
    return _Source(source.digest, frozenset((imported | parents) - {name, "wayloom"}), frozenset(packages))


@lru_cache(maxsize=4096)
def module_file(name: str, package: Path) -> Path | None:
    """The source of a module: of wayloom below `package`, of any other on the import path; None where there is none."""
    top, *parts = name.split(".")
    if top != "wayloom":
        return _file_elsewhere(name)
    place = package.joinpath(*parts)
    for file in (place / "__init__.py", place.with_suffix(".py")) if parts else (package / "__init__.py",):
        if file.is_file():
            return file
    return None


def _file_elsewhere(name: str) -> Path | None:
    from importlib.util import find_spec

    try:
        spec = find_spec(name)
    except (ImportError, ValueError):
        return None
    return None if spec is None or spec.origin is None or not spec.origin.endswith(".py") else Path(spec.origin)


def _parents(name: str) -> Iterator[str]:
    """The packages that hold a module of wayloom, which are imported before it, but for the outermost."""
    parts = name.split(".")
    if parts[0] == "wayloom":
        yield from (".".join(parts[:count]) for count in range(2, len(parts)))
