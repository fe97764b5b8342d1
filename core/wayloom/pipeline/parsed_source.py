"""Parsed source of one file: the digest of its code and the imports in it, kept by the hash of the content.

Parsing takes far longer than hashing. So what was found is kept beside the compiled kernels, in one file for each version of Python
and of this module. It is looked up by content, never by name or time: it cannot be stale.
"""

import ast
import contextlib
import gc
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType
from typing import Any, Final

from wayloom.files.atomic import write_atomically
from wayloom.files.regular import read_regular

MOST_KEPT: Final = 2048
"""Sources that the file holds; where there would be more it starts anew with those of one process."""
MOST_BYTES: Final = 16 << 20

BLOCKS: Final = ("body", "orelse", "finalbody", "handlers", "cases")
COMPOUND: Final = (
    ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith, ast.Try,
    ast.TryStar, ast.ExceptHandler, ast.Match, ast.match_case,
)  # fmt: skip
"""Statements that hold other statements, and where they hold them."""


@dataclass(frozen=True, slots=True)
class ParsedSource:
    """A file: the digest of its code, and (module, names taken from it) of each import, but for those under TYPE_CHECKING."""

    digest: str
    imports: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(slots=True)
class ParsedSources:
    """Sources that were parsed in this process or, by what `file` says, in another one.

    file : where they are kept; None for in this process only
    A file that is missing, damaged or cannot be written costs time and nothing else. Of two processes that write at the same time
    one loses what it added, and parses it again next time.
    """

    file: Path | None
    _kept: dict[str, ParsedSource] = field(default_factory=dict)
    _used: dict[str, ParsedSource] = field(default_factory=dict)
    _is_read: bool = False

    def of(self, content: bytes) -> ParsedSource:
        """The source with this content. Raises SyntaxError."""
        sha = hashlib.sha256(content).hexdigest()
        if sha not in self._used:
            if not self._is_read:
                self._kept, self._is_read = _read(self.file), True
            self._used[sha] = self._kept.get(sha) or parsed(content)
        return self._used[sha]

    def keep(self) -> None:
        """Write what was parsed and is not kept yet."""
        if self.file is None or self._used.keys() <= self._kept.keys():
            return
        together = _read(self.file) | self._used
        self._kept = together if len(together) <= MOST_KEPT else dict(self._used)
        with contextlib.suppress(OSError):
            _write(self.file, self._kept)


def kept_sources() -> ParsedSources:
    """Those that all processes of this user share, in the folder of the compiled kernels."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    state = hashlib.sha256(sys.version.encode() + Path(__file__).read_bytes()).hexdigest()
    return ParsedSources(Path(folder) / f"sources-{state[:16]}.json" if folder else None)


def _read(file: Path | None) -> dict[str, ParsedSource]:
    """What a file of `_write` holds; nothing where it is not there or not whole."""
    if file is None:
        return {}
    try:
        checksum, _, text = read_regular(file, MOST_BYTES).partition(b"\n")
    except OSError:
        return {}
    if checksum != _checksum(text):
        return {}
    kept: dict[str, Any] = json.loads(text)
    return {sha: ParsedSource(code, tuple((name, tuple(names)) for name, names in found)) for sha, (code, found) in kept.items()}


def _write(file: Path, sources: dict[str, ParsedSource]) -> None:
    text = json.dumps({sha: (source.digest, source.imports) for sha, source in sources.items()}).encode()
    write_atomically(file, _checksum(text) + b"\n" + text)


def _checksum(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest().encode()


def parsed(content: bytes) -> ParsedSource:
    """The source with this content, parsed here and now. Raises SyntaxError."""
    with _without_garbage_collection():
        tree = ast.parse(content)
        imports = tuple(_simplified(tree))
        digest = hashlib.sha256()
        for part in _parts_of(compile(tree, "", "exec", dont_inherit=True)):
            digest.update(part.encode("utf-8", "surrogatepass") + b"\n")
    return ParsedSource(digest.hexdigest(), imports)


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
