"""The rows of a study, computed on Dask: a cluster on this machine, or any other by its address.

Rows go to workers in batches that last a fraction of a second, so that handing them over costs next
to nothing, and a run that is stopped repeats no more than the batches at work.

References
----------
Rocklin (2015), Dask.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from necc_casadi.errors import OptionError
from necc_casadi.study.rows import Row

__all__ = ["Job", "computed"]


#: Seconds of computing that a batch is to take, rows in it at most, and batches that each worker
#: has at hand.
_LASTS, _MOST, _AHEAD = 0.5, 500, 2


#: What every worker needs, and takes long to load.
_PRELOADED = ("distributed", "necc_casadi.study.montecarlo", "necc_casadi.study.sweep")


class Job(Protocol):
    """What computes a row from its number: a value that can be sent, and prepares itself there."""

    def row(self, index: int) -> Row:
        """One row, a function of the job and the number alone."""


def _batch(job: Job, indices: Sequence[int]) -> tuple[list[tuple[int, Row]], float]:
    """Rows, and the seconds of computing that each took, however busy the machine was."""
    began = time.thread_time()
    rows = [(index, job.row(index)) for index in indices]
    return rows, (time.thread_time() - began) / len(indices)


def computed(
    job: Job, indices: Sequence[int], scheduler: str | None, workers: int | None
) -> Iterator[list[tuple[int, Row]]]:
    """Finished rows with their numbers, batch by batch, in the order in which they finish.

    Raises
    ------
    OptionError
        When Dask is not installed, or no scheduler answers at the address.
    """
    if not indices:
        return
    try:
        from distributed import as_completed
    except ImportError:
        raise OptionError(
            "usage",
            "studies run on Dask, which is not installed",
            "Install it: python -m pip install 'necc-casadi[study]'.",
        ) from None
    with _client(scheduler, min(workers or os.cpu_count() or 1, len(indices))) as client:
        sent = client.scatter(job, broadcast=True, hash=False)
        waiting = _Waiting(list(indices))
        count = max(1, len(client.nthreads()))

        def submit() -> Any:
            return client.submit(_batch, sent, waiting.batch(count), pure=False)

        tasks = as_completed([submit() for _ in range(_AHEAD * count) if waiting.left])
        for task in tasks:
            rows, seconds = task.result()
            waiting.lasted(seconds)
            if waiting.left:
                tasks.add(submit())
            yield rows


@dataclass
class _Waiting:
    """Rows that nobody works at, and how long one of them takes."""

    left: list[int]
    seconds: float | None = field(default=None)

    def lasted(self, seconds: float) -> None:
        """Learn from a batch; the first one loads and prepares, and so tells too much."""
        before = seconds if self.seconds is None else self.seconds
        self.seconds = min(seconds, 0.5 * (before + seconds))

    def batch(self, workers: int) -> list[int]:
        """The next rows; few where little is left, so that no worker ends long after the others."""
        size = 1 if self.seconds is None else int(_LASTS / max(self.seconds, 1e-9))
        size = max(1, min(size, _MOST, len(self.left) // (_AHEAD * workers)))
        taken, self.left = self.left[:size], self.left[size:]
        return taken


def _settings() -> dict[str, Any]:
    """Nothing that watches; workers forked, where that goes, from a process that has loaded all."""
    settings: dict[str, Any] = {
        "distributed.scheduler.dashboard.enabled": False,
        "distributed.worker.profile.enabled": False,
        "distributed.worker.memory.monitor-interval": "5s",
        "distributed.admin.tick.interval": "5s",
        "distributed.admin.tick.limit": "1h",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.admin.system-monitor.gil.enabled": False,
    }
    if sys.platform != "win32":
        settings["distributed.worker.multiprocessing-method"] = "forkserver"
    return settings


def _preload() -> None:
    """Let that process load this package, too: each worker would do so for itself."""
    if sys.platform == "win32":
        return
    from distributed.utils import get_mp_context

    get_mp_context()  # its own wishes come first
    multiprocessing.set_forkserver_preload([*_PRELOADED])


@contextlib.contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Any]:
    from dask import config
    from distributed import Client, LocalCluster

    with config.set(_settings()), contextlib.ExitStack() as stack:
        if scheduler is None:
            _preload()
        address: Any = scheduler
        if scheduler is None:
            address = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    silence_logs=50,
                )
            )
        try:
            client = stack.enter_context(Client(address, timeout="10s"))
        except (OSError, ValueError) as problem:
            raise OptionError(
                "usage",
                f"--scheduler {scheduler}: nobody answers ({' '.join(str(problem).split())})",
                "Start one with `dask scheduler` and `dask worker`, or leave the option out.",
            ) from None
        yield client
