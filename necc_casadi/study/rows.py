"""rows.csv of a study: each finished row is kept at once, and a study goes on where it ended.

A run that is killed at any moment leaves whole lines and at most one torn one, which the next run
cuts off. ``study.json`` beside it says which study the rows belong to.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from necc_casadi.errors import OutputError
from necc_casadi.files import CHOOSE, read_text, write_text

__all__ = ["ROWS", "STUDY", "Row", "Rows", "opened"]


ROWS, STUDY = "rows.csv", "study.json"


#: Values of one row: numbers, words, truth values; None where there is none.
Row = Sequence[Any]


_LARGEST = 1 << 20  # bytes of study.json


class Rows:
    """The rows of a study that are finished, and a file that more are added to."""

    def __init__(self, path: Path, columns: Sequence[str], count: int, handle: int) -> None:
        self._path, self._columns, self._count, self._handle = path, tuple(columns), count, handle
        self.done: dict[int, list[str]] = {}

    @property
    def missing(self) -> list[int]:
        """Which rows are not finished."""
        return [index for index in range(self._count) if index not in self.done]

    def read(self) -> None:
        """Read what an earlier run has finished; a torn last line is cut off."""
        data = self._path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.ftruncate(self._handle, whole)
            os.fsync(self._handle)
        lines = list(csv.reader(io.StringIO(data[:whole].decode())))
        head = ["row", *self._columns]
        if not lines:
            self._write(_line(head))
            return
        if lines[0] != head or any(not self._is_row(line) for line in lines[1:]):
            raise OutputError(
                "output", f"{self._path} was changed by hand", "Move it away; the study goes on."
            )
        self.done = {int(line[0]): line[1:] for line in lines[1:]}

    def _is_row(self, line: Sequence[str]) -> bool:
        fits = len(line) == len(self._columns) + 1
        return fits and line[0].isdigit() and int(line[0]) < self._count

    def add(self, finished: Sequence[tuple[int, Row]]) -> None:
        """Keep rows that have just been finished; after this they are on the disk."""
        lines = []
        for index, row in finished:
            if index not in self.done:
                self.done[index] = [_cell(value) for value in row]
                lines.append(_line([str(index), *self.done[index]]))
        self._write("".join(lines))

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:  # to the end of the file, whoever else has it open
            data = data[os.write(self._handle, data) :]
        os.fsync(self._handle)

    def in_order(self) -> list[list[str]]:
        """The finished rows, each with its number first."""
        return [[str(index), *self.done[index]] for index in sorted(self.done)]


@contextlib.contextmanager
def opened(
    out: Path, columns: Sequence[str], count: int, study: Mapping[str, Any]
) -> Iterator[Rows]:
    """The rows of the study in a folder, which is made where it is absent.

    Raises
    ------
    OutputError
        When the folder holds another study, or files of somebody else in its place, when another
        run is at work in it, or when it cannot be written.
    """
    text = json.dumps({**study, "columns": list(columns), "rows": count}, indent=1) + "\n"
    try:
        out.mkdir(parents=True, exist_ok=True)
        known = (out / STUDY).exists()
        if known and read_text(out / STUDY, _LARGEST) != text:
            raise OutputError(
                "output", f"{out} holds another study", "Choose another folder with --out."
            )
        if not known and os.path.lexists(out / ROWS):
            raise OutputError(
                "output", f"{out / ROWS} would be changed, and no study wrote it", CHOOSE
            )
        if not known:
            write_text(out / STUDY, text)
        handle = os.open(out / ROWS, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
        raise OutputError("output", f"{out} cannot be written: {reason}", CHOOSE) from None
    try:
        _lock(handle, out)
        rows = Rows(out / ROWS, columns, count, handle)
        rows.read()
        yield rows
    finally:
        os.close(handle)


def _lock(handle: int, out: Path) -> None:
    """Two runs would do everything twice."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise OutputError(
            "output",
            f"{out} is being filled by another run",
            "Wait for it to end, or choose another folder with --out.",
        ) from None


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _line(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([cell.replace("\n", " ") for cell in cells])
    return text.getvalue()
