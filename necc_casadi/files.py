"""Writing files: whole or not at all, in strict JSON, into folders that were looked at first."""

from __future__ import annotations

import json
import math
import os
import tempfile
from pathlib import Path
from typing import Any

from necc_casadi.errors import OutputError

__all__ = ["check_writable", "finite", "to_json_text", "write_text"]


def finite(value: Any) -> Any:
    """The same data with None for numbers that are not finite, and lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_json_text(value: Any, indent: int | None = None) -> str:
    """Strict JSON, one line unless indented; null for numbers that are not finite."""
    return json.dumps(finite(value), indent=indent, ensure_ascii=False, allow_nan=False)


def write_text(path: Path, content: str | bytes) -> Path:
    """Write a file under a temporary name and rename it into place.

    Raises
    ------
    OutputError
        When the folder cannot be made or written; nothing is left behind then.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as problem:
        raise OutputError(
            "output",
            f"{path} cannot be written: {problem.strerror or problem}",
            "Choose a folder that can be written with --out.",
        ) from None
    return path


def check_writable(folder: Path) -> None:
    """Refuse early, before any work, where `folder` cannot be made or written.

    Raises
    ------
    OutputError
        Naming the folder.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(
            "output",
            f"{folder} cannot be written: {existing} is "
            + ("read-only" if existing.is_dir() else "not a folder"),
            "Choose a folder that can be written with --out.",
        )
