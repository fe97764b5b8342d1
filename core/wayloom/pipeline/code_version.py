"""Code version of a module: a digest of all that it imports of wayloom, and the versions of the libraries that make its numbers.

The transitive closure is found in the source, without importing anything: every `import` of a wayloom module, in functions too, but
not under TYPE_CHECKING. A file counts by its bytecode without docstrings and line numbers, so that a comment, a docstring or
a blank line changes no version. The package's own __init__ does not count: it says the version and prepares caches.
"""

import ast
import gc
import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import CodeType
from typing import Any, Final

import wayloom
from wayloom.errors import StageError

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


BLOCKS: Final = ("body", "orelse", "finalbody", "handlers", "cases")
COMPOUND: Final = (
    ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith, ast.Try,
    ast.TryStar, ast.ExceptHandler, ast.Match, ast.match_case,
)  # fmt: skip
"""Statements that hold other statements, and where they hold them."""


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
    with _without_garbage_collection():
        while todo:
            name = todo.pop()
            found[name] = _source(name, package)
            todo |= found[name].modules - found.keys()
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


def _source(name: str, package: Path) -> _Source:
    file = module_file(name, package)
    if file is None:
        raise StageError(f"no module {name} below {package.parent}: the catalogue of stages names it")
    digest, imports = _parsed(file.read_bytes())
    imported, packages = set[str](), set[str]()
    for module, names in imports:
        if module.split(".")[0] != "wayloom":
            packages.add(module.split(".")[0])
            continue
        imported |= {part for part in (module, *(f"{module}.{name}" for name in names)) if module_file(part, package) is not None}
    parents = {parent for part in {name, *imported} for parent in _parents(part)}
    return _Source(digest, frozenset((imported | parents) - {name, "wayloom"}), frozenset(packages))


@lru_cache(maxsize=1024)
def _parsed(content: bytes) -> tuple[str, tuple[tuple[str, tuple[str, ...]], ...]]:
    """The digest of a source's code, and its imports as of `_simplified`."""
    tree = ast.parse(content)
    imports = tuple(_simplified(tree))
    digest = hashlib.sha256()
    for part in _parts_of(compile(tree, "", "exec", dont_inherit=True)):
        digest.update(part.encode("utf-8", "surrogatepass") + b"\n")
    return digest.hexdigest(), imports


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


def _simplified(tree: ast.Module) -> list[tuple[str, tuple[str, ...]]]:
    """Strip the tree, in place, of docstrings and strings that document the line above, and return (module, names taken from it) of
    every import but those under TYPE_CHECKING. Expressions are not looked into."""
    imports: list[tuple[str, tuple[str, ...]]] = []
    todo: list[tuple[ast.AST, bool]] = [(tree, True)]
    while todo:
        node, runs = todo.pop()
        for name in BLOCKS:
            block: list[ast.AST] = getattr(node, name, [])
            here = runs and not (name == "body" and isinstance(node, ast.If) and _names_type_checking(node.test))
            for child in block:
                if isinstance(child, COMPOUND):
                    todo.append((child, here))
                elif here and isinstance(child, ast.Import):
                    imports += ((alias.name, ()) for alias in child.names)
                elif here and isinstance(child, ast.ImportFrom) and child.module is not None and child.level == 0:
                    imports.append((child.module, tuple(alias.name for alias in child.names)))
            if any(map(_is_text, block)):
                block[:] = [line for line in block if not _is_text(line)] or [ast.copy_location(ast.Pass(), block[0])]
    return imports


def _names_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _parts_of(code: CodeType) -> Iterator[str]:
    """What makes a code object do what it does, without file names and line numbers."""
    yield f"{code.co_qualname} {code.co_flags} {code.co_argcount} {code.co_posonlyargcount} {code.co_kwonlyargcount}"
    yield f"{code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars}"
    yield code.co_code.hex()
    yield code.co_exceptiontable.hex()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _parts_of(constant)
        else:
            yield _text_of(constant)


def _text_of(constant: Any) -> str:
    """A constant as text that does not depend on the order of a set."""
    if isinstance(constant, frozenset):
        return f"frozenset({sorted(_text_of(item) for item in constant)})"
    if isinstance(constant, tuple):
        return f"({', '.join(_text_of(item) for item in constant)})"
    return repr(constant)


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Trees of syntax are many small objects that die together: looking for cycles among them doubles the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
