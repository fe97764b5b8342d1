"""Growing arrays: small ones in memory, large ones in a file without a name.

So a drive of hours needs no more memory than one of minutes.
"""

import mmap
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from typing import IO, TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Table = TypeVar("Table", bound="DataclassInstance")
IN_MEMORY_BYTES = 1_000_000
"""A longer array goes to the folder for temporary files."""


class GrowingArray:
    """Rows of one type and shape, appended. row : shape of each, () for numbers."""

    def __init__(self, dtype: DTypeLike, row: tuple[int, ...] = (), in_memory_bytes: int | None = None) -> None:
        self.dtype, self.row = np.dtype(dtype), row
        self.in_memory_bytes = IN_MEMORY_BYTES if in_memory_bytes is None else in_memory_bytes
        self.rows = self.waiting_bytes = 0
        self.waiting: list[NDArray[Any]] = []
        self.file: IO[bytes] | None = None

    def __len__(self) -> int:
        return self.rows

    def append(self, values: NDArray[Any]) -> None:
        """Copies of values (n, *row), converted to the array's type. Raises OSError where the disk is full."""
        chunk = np.array(values, self.dtype).reshape(-1, *self.row)
        self.waiting.append(chunk)
        self.rows += len(chunk)
        self.waiting_bytes += chunk.nbytes
        if self.waiting_bytes > self.in_memory_bytes:
            self._write()

    def array(self) -> NDArray[Any]:
        """(len, *row), whole: of a long one a view of its file, not to be written to. Raises OSError where the disk is full."""
        if self.file is None:
            return np.concatenate([np.zeros((0, *self.row), self.dtype), *self.waiting])
        self._write()
        with _naming_the_folder():
            self.file.flush()
        return np.asarray(np.memmap(self.file, self.dtype, "r", shape=(self.rows, *self.row)))  # keeps the file open itself

    def __del__(self) -> None:
        if self.file is not None:
            with suppress(OSError):  # what a full disk did not take
                self.file.close()

    def _write(self) -> None:
        """Everything that waits goes to the file, which is made when it is first needed and is gone with its last user."""
        with _naming_the_folder():
            if self.file is None:
                self.file = tempfile.TemporaryFile(prefix="wayloom-")  # noqa: SIM115
            for chunk in self.waiting:
                self.file.write(chunk.tobytes())
        self.waiting, self.waiting_bytes = [], 0


@contextmanager
def _naming_the_folder() -> Iterator[None]:
    """An error of a file without a name names the folder for temporary files."""
    try:
        yield
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, tempfile.gettempdir()) from problem


class GrowingTable(Generic[Table]):
    """Rows of a table, a dataclass whose fields are all arrays (n, …), appended part by part; begun by an empty one."""

    def __init__(self, empty: Table) -> None:
        self._kind = type(empty)
        columns = {field.name: getattr(empty, field.name) for field in fields(empty)}
        self._columns = {name: GrowingArray(column.dtype, column.shape[1:]) for name, column in columns.items()}

    def append(self, part: Table) -> None:
        """Copies of a part's rows. Raises OSError where the disk is full."""
        for name, column in self._columns.items():
            column.append(getattr(part, name))

    def table(self) -> Table:
        """All rows; long columns are views of files, which are not to be written to. Raises OSError where the disk is full."""
        return self._kind(**{name: column.array() for name, column in self._columns.items()})


def forget_pages(array: NDArray[Any]) -> None:
    """Let go of the memory into which an array that lies in a file was read; it is read again where it is looked at again. Of any
    other array nothing happens."""
    base: Any = array
    while isinstance(base, np.ndarray) and not isinstance(base, np.memmap):
        base = base.base
    if isinstance(base, np.memmap) and hasattr(mmap, "MADV_DONTNEED"):
        base._mmap.madvise(mmap.MADV_DONTNEED)  # type: ignore[attr-defined]
