"""The stages of a run: named while they last, timed afterwards."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

__all__ = ["Clock", "Say"]

#: Hears what is being done.
Say = Callable[[str], None]


@dataclass(frozen=True)
class Clock:
    """Says what is being done, and keeps how long it took."""

    say: Say
    timings: dict[str, float] = field(default_factory=dict)  # s, by stage

    @contextlib.contextmanager
    def stage(self, name: str, text: str) -> Iterator[None]:
        """A block that takes its time."""
        self.say(text)
        began = time.perf_counter()
        yield
        self.timings[name] = time.perf_counter() - began
