"""A study from its first row, or from where it ended, to its last."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from necc_casadi.study.cluster import Job, computed
from necc_casadi.study.rows import opened
from necc_casadi.study.tables import Table

__all__ = ["Study", "fill"]


class Study(Job, Protocol):
    """A job whose rows are a table."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the values in a row."""

    @property
    def study(self) -> Mapping[str, Any]:
        """What tells this study from others, as JSON."""


def fill(
    study: Study,
    count: int,
    out: Path,
    told: Callable[[int], None],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> Table:
    """Compute the rows that are missing in a folder, each kept as soon as it is finished.

    Parameters
    ----------
    study
        What is computed.
    count
        Number of rows.
    out
        Folder of ``rows.csv``; made where it is absent.
    told
        Called with the number of rows that are finished.
    scheduler
        Address of a Dask scheduler; by default a cluster is started on this machine.
    workers
        Processes of that cluster; by default one per core.

    Raises
    ------
    OutputError
        When the folder cannot be used, or holds another study.
    OptionError
        When Dask is not installed, or nobody answers at the address.
    """
    with opened(out, study.columns, count, study.study) as rows:
        told(len(rows.done))
        for finished in computed(study, rows.missing, scheduler, workers):
            rows.add(finished)
            told(len(rows.done))
        return Table(study.columns, rows.in_order())
