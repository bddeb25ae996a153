"""Files: written whole or not at all, listed with their hashes, read within bounds."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from necc_casadi.errors import OutputError

__all__ = [
    "CHOOSE",
    "JOURNAL",
    "LISTING",
    "check_writable",
    "finite",
    "hash_of",
    "inside",
    "listing_text",
    "read_listing",
    "read_text",
    "refuse_unfinished",
    "staging_places",
    "to_json_text",
    "write_text",
]


#: What helps where a folder cannot be used.
CHOOSE = "Choose a folder that can be written with --out."


#: The list of the files that the tool wrote into a folder, with the hash of each.
LISTING = "files.json"


#: A finished folder whose files are being moved into place one by one holds this beside them.
JOURNAL = ".necc-whole"


_LISTING_FORMAT = 1


_LARGEST_LISTING = 1 << 20  # bytes


#: A pipe does not block with these, where a system has such things.
_READ = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def finite(value: Any) -> Any:
    """The same data with None for numbers that are not finite, and lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_json_text(value: Any, indent: int | None = None, *, ascii_only: bool = False) -> str:
    """Strict JSON, one line unless indented; null for numbers that are not finite."""
    return json.dumps(finite(value), indent=indent, ensure_ascii=ascii_only, allow_nan=False)


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
            "output", f"{path} cannot be written: {problem.strerror or problem}", CHOOSE
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
            CHOOSE,
        )


def read_text(path: Path, largest: int) -> str:
    """A regular file of at most `largest` bytes, as UTF-8.

    A pipe or a device in its place would block or never end: only a regular file is read.

    Raises
    ------
    OSError
        When it cannot be opened, or is no regular file, or is larger.
    UnicodeDecodeError
        When it is not UTF-8.
    """
    handle = os.open(path, _READ)
    with os.fdopen(handle, "rb") as stream:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError(0, "not a regular file")
        data = stream.read(largest + 1)
    if len(data) > largest:
        raise OSError(0, f"more than {largest} bytes")
    return data.decode()


def hash_of(path: Path) -> str | None:
    """SHA-256 of a regular file; None where there is none."""
    try:
        handle = os.open(path, _READ | getattr(os, "O_NOFOLLOW", 0))
        with os.fdopen(handle, "rb") as stream:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                return None
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def listing_text(hashes: Mapping[str, str]) -> str:
    """The content of ``files.json``: relative path -> SHA-256."""
    data = {"format": _LISTING_FORMAT, "made_by": "necc-casadi", "files": dict(hashes)}
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def read_listing(folder: Path) -> dict[str, str] | None:
    """The files that the tool wrote into `folder`, path -> SHA-256; None without a listing."""
    try:
        data: Any = json.loads(read_text(folder / LISTING, _LARGEST_LISTING))
        if data["made_by"] != "necc-casadi" or data["format"] != _LISTING_FORMAT:
            return None
        files = data["files"]
        return {path: files[path] for path in files if inside(path) and _hash(files[path])}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _hash(value: object) -> bool:
    return isinstance(value, str) and len(value) == 64


def inside(path: str) -> bool:
    """Whether a listed path stays below its folder."""
    parts = PurePosixPath(path).parts
    return bool(parts) and not PurePosixPath(path).is_absolute() and ".." not in parts


def staging_places(folder: Path) -> tuple[Path, Path]:
    """Where a new content of `folder` is written: beside it, or in it where that cannot be."""
    return folder.parent / f".{folder.name}.necc-new", folder / ".necc-new"


def refuse_unfinished(folder: Path) -> None:
    """Refuse a folder whose files were being moved into place when a run ended.

    Raises
    ------
    OutputError
        Saying that the next run of necc-design completes it.
    """
    for place in staging_places(Path(os.path.realpath(folder))):
        if (place / JOURNAL).exists():
            raise OutputError(
                "output",
                f"{folder} was being put in place when a run ended",
                f"Run necc-design again with --out {folder}: it completes the folder first.",
            )
