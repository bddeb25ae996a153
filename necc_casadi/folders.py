"""A folder that is put in place whole.

The new content is written beside the old folder and the two are exchanged by one call of the
operating system, so that a run that ends at any moment leaves the old folder or the new one. A
listing with hashes tells the files of the tool from those of others: the latter are carried over as
they are, and nothing of theirs is ever replaced or removed.

Where two folders cannot be exchanged (the working folder, a mount point, a parent that is
read-only, a system without such a call) the files are moved into place one by one under a journal:
a run that ends in between leaves a folder that every command refuses and the next run completes.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import shutil
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from necc_casadi.errors import OutputError
from necc_casadi.files import (
    CHOOSE,
    JOURNAL,
    LISTING,
    check_writable,
    hash_of,
    inside,
    listing_text,
    read_listing,
    read_text,
    staging_places,
    write_text,
)
from necc_casadi.interrupts import uninterrupted

__all__ = ["whole_folder"]


_UNFINISHED = ".necc-part"  # stands in a folder that is still being written


_MOVE = "Move it away, or choose another folder with --out."


_LARGEST_JOURNAL = 1 << 20  # bytes


#: A folder with more entries of others than this is theirs: it stays, and files move into it.
_MOST_CARRIED = 1000


@contextlib.contextmanager
def whole_folder(out: Path, expected: Iterable[str] = ()) -> Iterator[Path]:
    """A new, empty folder to write into; it takes the place of `out` when the block ends well.

    When the block is left by an exception, `out` stays as it was.

    Parameters
    ----------
    out
        The folder to replace; made with its parents where it is absent.
    expected
        Paths that will be written, so that a file of others in their place is found at once.

    Raises
    ------
    OutputError
        When another run is writing `out`, when it cannot be written, and when a file that the
        tool did not write, or that was changed since, stands where one would be written.
    """
    target = _Target(Path(os.path.realpath(out)), out)
    with target.readable_faults():
        check_writable(target.folder)
        created = _make_parents(target.folder)
        try:
            with _lock(target):
                for place in staging_places(target.folder):
                    _clear(place, target)
                _refuse_conflicts([*expected, LISTING], _ours(target), target)
                staging = _stage(target)
                try:
                    yield staging
                    with uninterrupted():
                        _put_in_place(staging, target)
                except BaseException:
                    with contextlib.suppress(OSError):
                        _discard(staging)
                    raise
        finally:
            for parent in created:
                with contextlib.suppress(OSError):
                    parent.rmdir()


@dataclass(frozen=True)
class _Target:
    """The folder to replace, and the name that the user gave it."""

    folder: Path  # without symbolic links
    named: Path

    @contextlib.contextmanager
    def readable_faults(self) -> Iterator[None]:
        """Faults in the words of the user: the folder that was named, not the one beside it."""
        places = staging_places(self.folder)
        try:
            yield
        except OutputError as problem:
            fault = problem.fault
            for place in places:
                fault = fault.replace(f"{place}{os.sep}", f"{self.named}{os.sep}")
            raise OutputError(problem.code, fault, problem.remedy) from None

    def changed(self, path: str) -> OutputError:
        """A file of the tool that is no longer what it wrote."""
        return OutputError(
            "output", f"{self.named / path} was changed by hand and would be replaced", _MOVE
        )

    def fault(self, problem: OSError) -> OutputError:
        """What the system said, about the folder that the user named."""
        text = problem.strerror or str(problem)
        return OutputError("output", f"{self.named} cannot be written: {text}", CHOOSE)


def _ours(target: _Target) -> dict[str, str]:
    """The files of the tool in the folder: path -> SHA-256, with an empty one for the listing.

    Raises
    ------
    OutputError
        When one was changed since: it is neither lost nor kept beside files of another run.
    """
    listed = read_listing(target.folder)
    for path, digest in (listed or {}).items():
        if os.path.lexists(target.folder / path) and hash_of(target.folder / path) != digest:
            raise target.changed(path)
    return {} if listed is None else {**listed, LISTING: ""}


def _refuse_conflicts(paths: Iterable[str], ours: Mapping[str, str], target: _Target) -> None:
    """Refuse where one of these paths is taken by something that the tool did not write."""
    for path in paths:
        above = [str(parent) for parent in PurePosixPath(path).parents][:-1]
        for taken in (*reversed(above), path):
            there = target.folder / taken
            free = taken in above and there.is_dir() and not there.is_symlink()
            if os.path.lexists(there) and not free and taken not in ours:
                raise OutputError(
                    "output",
                    f"{target.named / taken} would be replaced, and necc-design did not write it",
                    _MOVE,
                )


def _of_others(folder: Path, ours: Mapping[str, str]) -> dict[str, bool] | None:
    """What else stands in the folder: path -> whether it is a folder. None where it is a lot."""
    parents = {str(parent) for path in ours for parent in PurePosixPath(path).parents}
    others: dict[str, bool] = {}
    for path, is_folder in _entries(folder):
        if path not in ours and not (is_folder and path in parents):
            others[path] = is_folder
        if len(others) > _MOST_CARRIED:
            return None
    return others


def _entries(folder: Path) -> Iterator[tuple[str, bool]]:
    """Everything below a folder but the tool's own scaffolding: (path, whether it is a folder)."""
    own = {staging_places(folder)[1].name, _lock_name(folder, inside=True).name}
    todo = [""]
    while todo:
        below = todo.pop()
        for entry in sorted(os.scandir(folder / below), key=lambda entry: entry.name):
            path = f"{below}/{entry.name}" if below else entry.name
            is_folder = entry.is_dir(follow_symlinks=False)
            if below or entry.name not in own:
                yield path, is_folder
                if is_folder:
                    todo.append(path)


# --- the lock ------------------------------------------------------------------------------------


def _lock_name(folder: Path, *, inside: bool) -> Path:
    return folder / ".necc-lock" if inside else folder.parent / f".{folder.name}.necc-lock"


def _beside(folder: Path) -> bool:
    """Whether something can be written beside a folder."""
    return folder != folder.parent and os.access(folder.parent, os.W_OK | os.X_OK)


@contextlib.contextmanager
def _lock(target: _Target) -> Iterator[None]:
    """Hold the folder for this process; the system lets go of it when the process ends."""
    path = _lock_name(target.folder, inside=not _beside(target.folder))
    stream = _locked(path, target)
    try:
        stream.seek(0)
        stream.truncate()
        stream.write(f"{os.getpid()}\n".encode())
        stream.flush()
        yield
    finally:
        if sys.platform == "win32":
            stream.close()  # an open file cannot be removed there
        with contextlib.suppress(OSError):
            path.unlink()
        stream.close()


def _locked(path: Path, target: _Target) -> IO[bytes]:
    """The open lock file, locked. A file that its last owner removed in between is opened again."""
    while True:
        try:
            stream = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o644), "r+b")
        except OSError as problem:
            raise target.fault(problem) from None
        try:
            if not _take(stream):
                owner = stream.read(20).decode("ascii", "replace").strip()
                raise OutputError(
                    "output",
                    f"{target.named} is being written by another run"
                    + (f" (process {owner})" if owner.isdigit() else ""),
                    "Wait for it to end, or choose another folder with --out.",
                )
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(stream.fileno()), os.stat(path)):
                    return stream
        except OSError as problem:
            stream.close()
            raise target.fault(problem) from None
        except BaseException:
            stream.close()
            raise
        stream.close()


def _take(stream: IO[bytes]) -> bool:
    """Lock an open file; False where another process holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            stream.seek(1 << 30)  # far behind the number, which stays readable
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
            stream.seek(0)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        if problem.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            stream.seek(0)
            return False
        raise
    return True


# --- writing and putting in place ----------------------------------------------------------------


def _make_parents(folder: Path) -> list[Path]:
    """Make the folders above; those that were made, the deepest first."""
    missing = [parent for parent in folder.parents if not parent.exists()]
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise _Target(folder, folder).fault(problem) from None
    return missing


def _stage(target: _Target) -> Path:
    folder = target.folder
    staging = staging_places(folder)[0 if _beside(folder) and not os.path.ismount(folder) else 1]
    try:
        staging.mkdir()
    except OSError as problem:
        raise target.fault(problem) from None
    (staging / _UNFINISHED).touch()
    return staging


def _put_in_place(staging: Path, target: _Target) -> None:
    folder = target.folder
    try:
        new = {
            path: hash_of(staging / path) or ""
            for path, is_folder in _entries(staging)
            if not is_folder and path != _UNFINISHED
        }
        write_text(staging / LISTING, listing_text(new))
        if not folder.exists():
            (staging / _UNFINISHED).unlink()
            os.rename(staging, folder)
            return
        ours = _ours(target)
        _refuse_conflicts([*new, LISTING], ours, target)
        others = _of_others(folder, ours) if _exchangeable(staging, folder) else None
        if others is not None:
            _carry(others, folder, staging)
            shutil.copymode(folder, staging)
            (staging / _UNFINISHED).unlink()
            if _exchange(staging, folder):
                _retire(staging, target, latest=True)
                return
            (staging / _UNFINISHED).touch()
        journal = {"old": ours, "new": {**new, LISTING: ""}}
        write_text(staging / JOURNAL, json.dumps(journal))
        (staging / _UNFINISHED).unlink(missing_ok=True)
        _move_in(staging, target)
    except OSError as problem:
        raise target.fault(problem) from None


def _exchangeable(staging: Path, folder: Path) -> bool:
    """Whether the folder may become another one: nobody's shell is left in a removed folder."""
    here = Path.cwd().resolve()
    return staging.parent == folder.parent and folder != here and folder not in here.parents


def _carry(others: Mapping[str, bool], folder: Path, staging: Path) -> None:
    """Give the new folder what the old one holds of others: the same files, by a second name."""
    for path, is_folder in others.items():
        source, copy = folder / path, staging / path
        if is_folder:
            copy.mkdir(parents=True, exist_ok=True)
            shutil.copystat(source, copy)
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, copy, follow_symlinks=False)
        except (OSError, NotImplementedError):
            if not stat.S_ISREG(os.lstat(source).st_mode) and not source.is_symlink():
                raise
            shutil.copy2(source, copy, follow_symlinks=False)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; False where the system or the file system cannot."""
    if sys.platform == "win32":
        return False
    names = os.fsencode(one), os.fsencode(other)
    library = ctypes.CDLL(None, use_errno=True)
    if hasattr(library, "renameat2"):
        failed = library.renameat2(-100, names[0], -100, names[1], 2)
    elif hasattr(library, "renamex_np"):
        failed = library.renamex_np(*names, 2)
    else:
        return False
    number = ctypes.get_errno()
    if failed and number in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
        raise OSError(number, os.strerror(number))
    return not failed


def _move_in(staging: Path, target: _Target) -> None:
    """Move a finished folder into the old one, file by file; begun again, it goes on.

    Raises
    ------
    OutputError
        Before anything moves, when something else stands in the place of a file.
    """
    journal = json.loads(read_text(staging / JOURNAL, _LARGEST_JOURNAL))
    old, new, folder = dict(journal["old"]), dict(journal["new"]), target.folder
    for path in {**old, **new}:
        if not inside(path):
            raise ValueError(f"{path} leads out of the folder")
        there = hash_of(folder / path)
        known = there is not None and (path == LISTING or there in (old.get(path), new.get(path)))
        if os.path.lexists(folder / path) and not known:
            raise target.changed(path)
    for path in new:
        if os.path.lexists(staging / path):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            os.replace(staging / path, folder / path)
    for path in set(old) - set(new):
        (folder / path).unlink(missing_ok=True)
        _remove_empty(folder / path, folder)
    (staging / JOURNAL).unlink()
    _retire(staging, target, latest=False)


def _remove_empty(path: Path, top: Path) -> None:
    """Remove the folders above a removed file, up to `top`, as far as they are empty."""
    for parent in path.parents:
        if parent == top:
            return
        with contextlib.suppress(OSError):
            parent.rmdir()


# --- what earlier runs left ----------------------------------------------------------------------


def _clear(place: Path, target: _Target) -> None:
    """Clean up after a run that was killed; only what is certainly the tool's is removed."""
    if not os.path.lexists(place):
        return
    try:
        if place.is_symlink() or not place.is_dir():
            raise OutputError("output", f"{place.parent} holds {place.name}, no folder", _MOVE)
        if (place / JOURNAL).exists():
            (place / _UNFINISHED).unlink(missing_ok=True)
            _move_in(place, target)
        elif (place / _UNFINISHED).exists() or not any(place.iterdir()):
            _discard(place)
        else:
            _retire(place, target, latest=False)
    except OSError as problem:
        raise target.fault(problem) from None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise OutputError(
            "output", f"{place.parent} holds {place.name}, not readable: {problem!r}", _MOVE
        ) from None


def _discard(staging: Path) -> None:
    """Remove an unfinished folder, its mark last."""
    if not (staging / _UNFINISHED).exists() and any(staging.iterdir()):
        return
    for child in staging.iterdir():
        if child.is_dir() and not child.is_symlink():
            shutil.rmtree(child)
        elif child.name != _UNFINISHED:
            child.unlink()
    (staging / _UNFINISHED).unlink(missing_ok=True)
    staging.rmdir()


def _retire(old: Path, target: _Target, *, latest: bool) -> None:
    """Remove a folder whose successor is in place, but nothing that only it holds.

    `latest`: whether it stood in place until now, so that its files of others are the last ones.

    Raises
    ------
    OutputError
        When a file stays in it that cannot be placed.
    """
    folder = target.folder
    ours, new = read_listing(old) or {}, read_listing(folder) or {}
    kept = []
    for path, is_folder in list(_entries(old)):
        here, there = old / path, folder / path
        if is_folder or path == LISTING:
            continue
        if _same(here, there) or (path in ours and hash_of(here) == ours[path]):
            here.unlink()
        elif path not in new and (latest or not os.path.lexists(there)):
            there.parent.mkdir(parents=True, exist_ok=True)
            os.replace(here, there)
        else:
            kept.append(path)
    if kept:
        raise OutputError(
            "output", f"{old.parent} keeps a changed {old.name}{os.sep}{kept[0]}", _MOVE
        )
    folders = [path for path, is_folder in _entries(old) if is_folder]
    for path in sorted(folders, key=len, reverse=True):
        (old / path).rmdir()
    (old / LISTING).unlink(missing_ok=True)
    old.rmdir()


def _same(one: Path, other: Path) -> bool:
    """Whether two paths are one file, or two with the same content."""
    try:
        if os.path.samestat(os.lstat(one), os.lstat(other)):
            return True
    except OSError:
        return False
    if one.is_symlink() and other.is_symlink():
        return os.readlink(one) == os.readlink(other)
    digest = hash_of(one)
    return digest is not None and digest == hash_of(other)
