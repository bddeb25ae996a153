"""The finished rows of a study as tables: CSV, and Parquet where pyarrow is installed."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.files import write_text

__all__ = ["Table", "write_tables"]


class Table:
    """Rows in order, by the names of their columns; what is missing is None, or nan."""

    def __init__(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        self.columns, self.rows = ("row", *columns), rows

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def texts(self, name: str) -> list[str | None]:
        """A column as it stands in the file."""
        place = self.columns.index(name)
        return [row[place] or None for row in self.rows]

    def numbers(self, name: str) -> Vector:
        """A column of numbers; nan where there is none. A truth value is 1 or 0."""
        words = {None: "nan", "true": "1", "false": "0"}
        return np.array([float(words.get(text, text) or "nan") for text in self.texts(name)], float)

    def typed(self, name: str) -> list[Any]:
        """A column as truth values, whole numbers, numbers or texts, whatever all entries are."""
        texts = self.texts(name)
        known = [text for text in texts if text is not None]
        if known and set(known) <= {"true", "false"}:
            return [None if text is None else text == "true" for text in texts]
        kinds: tuple[Callable[[str], Any], ...] = (int, float)
        for kind in kinds:
            try:
                return [None if text is None else kind(text) for text in texts]
            except ValueError:
                continue
        return list(texts)


def write_tables(table: Table, out: Path) -> list[Path]:
    """table.csv, in order of the rows, and table.parquet."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    files = [write_text(out / "table.csv", text.getvalue())]
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        return files
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table({name: table.typed(name) for name in table.columns}), sink)
    return [*files, write_text(out / "table.parquet", sink.getvalue().to_pybytes())]
