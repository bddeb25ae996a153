"""A folder is the old one or the new one, whole, whenever a run ends; files of others stay."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from necc_casadi import folders
from necc_casadi.errors import OutputError
from necc_casadi.files import LISTING, hash_of, read_listing, refuse_unfinished, write_text
from necc_casadi.folders import whole_folder


def write(out, number, *, stale=False, expected=()):
    """A run: some files that all hold its number."""
    with whole_folder(Path(out), expected) as folder:
        for name in ("design.json", "c/necc.c", *(["figures/stale.png"] if stale else [])):
            write_text(folder / name, f"{number}\n")


def content(out) -> dict[str, str]:
    return {
        path.relative_to(out).as_posix(): path.read_text()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != LISTING
    }


def check_whole(out, number, **others):
    """Exactly what one run wrote, its listing true, and what others keep there."""
    expected = {"design.json": f"{number}\n", "c/necc.c": f"{number}\n"}
    found = content(out)
    assert expected.items() <= found.items()
    assert set(found) - set(expected) <= {*others, "figures/stale.png"}
    listed = read_listing(out)
    assert set(listed) == set(found) - set(others)
    assert all(hash_of(out / path) == digest for path, digest in listed.items())
    assert {name: found[name] for name in others} == others
    assert not [path for path in out.parent.rglob("*") if ".necc-" in path.name]


WAYS = ("exchanged", "file by file")


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """Both ways to put a folder in place."""
    if request.param == "file by file":
        monkeypatch.setattr(folders, "_exchange", lambda one, other: False)
    return request.param


def test_a_folder_is_made_with_its_parents_and_replaced_whole(tmp_path, way):
    out = tmp_path / "a" / "b" / "out"
    write(out, 1, stale=True)
    check_whole(out, 1)
    assert (out / "figures" / "stale.png").exists()
    write(out, 2)
    check_whole(out, 2)
    assert not (out / "figures").exists()


def test_files_of_others_are_carried_over_as_they_are(tmp_path, way):
    out = tmp_path / "out"
    write(out, 1, stale=True)
    (out / "notes.txt").write_text("mine")
    (out / "c" / "own.c").write_text("mine too")
    (out / "empty" / "inner").mkdir(parents=True)
    (out / "link").symlink_to("nowhere")
    os.mkfifo(out / "pipe")
    (out / "figures" / "own.png").write_text("drawn by hand")
    node = os.stat(out / "notes.txt").st_ino
    write(out, 2)
    others = {"notes.txt": "mine", "c/own.c": "mine too", "figures/own.png": "drawn by hand"}
    check_whole(out, 2, **others)
    assert os.stat(out / "notes.txt").st_ino == node
    assert (out / "empty" / "inner").is_dir()
    assert os.readlink(out / "link") == "nowhere"
    assert (out / "pipe").is_fifo()


@pytest.mark.parametrize("place", ["design.json", "c/necc.c", "c", LISTING])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_a_file_of_others_is_never_replaced(tmp_path, place, kind, way):
    out = tmp_path / "out"
    path = out / place
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "file":
        path.write_text("mine")
    elif kind == "link":
        path.symlink_to(tmp_path)
    elif place == "c":
        return  # a folder may stand there
    else:
        (path / "inner").mkdir(parents=True)
    before = sorted(out.rglob("*"))
    with pytest.raises(OutputError, match="necc-design did not write it") as caught:
        write(out, 1)
    assert str(path) in caught.value.fault
    assert sorted(out.rglob("*")) == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_it_is_refused_before_the_work_where_the_file_was_foreseen(tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "necc.c").write_text("mine")
    with pytest.raises(OutputError), whole_folder(tmp_path, ["c/necc.c"]):
        pytest.fail("the work began")


@pytest.mark.parametrize("stale", [False, True])
def test_a_file_that_was_changed_by_hand_is_neither_replaced_nor_lost(tmp_path, stale, way):
    out = tmp_path / "out"
    write(out, 1, stale=True)
    name = "figures/stale.png" if stale else "design.json"
    (out / name).write_text("by hand")
    with pytest.raises(OutputError, match="changed by hand"):
        write(out, 2)
    assert (out / name).read_text() == "by hand"
    (out / name).unlink()  # a file that is gone is no obstacle
    write(out, 2)
    check_whole(out, 2)


def test_a_change_during_the_run_is_seen(tmp_path, way):
    out = tmp_path / "out"
    write(out, 1)
    with pytest.raises(OutputError, match="changed by hand"), whole_folder(out) as folder:  # noqa: PT012
        write_text(folder / "design.json", "2\n")
        (out / "design.json").write_text("by hand")
    assert (out / "design.json").read_text() == "by hand"


def test_an_edit_between_carrying_and_exchange_is_kept(tmp_path, monkeypatch):
    """Editors write a new file and rename it: the link that was carried is the old one."""
    out = tmp_path / "out"
    write(out, 1)
    (out / "notes.txt").write_text("old")
    exchange = folders._exchange

    def late(one, other):
        (out / "new").write_text("edited")
        os.replace(out / "new", out / "notes.txt")
        return exchange(one, other)

    monkeypatch.setattr(folders, "_exchange", late)
    write(out, 2)
    check_whole(out, 2, **{"notes.txt": "edited"})


def test_a_block_that_fails_changes_nothing(tmp_path):
    write(tmp_path / "out", 1)
    for fault in (KeyboardInterrupt, ZeroDivisionError, OutputError("output", "full", "")):
        for out in (tmp_path / "out", tmp_path / "new" / "deep"):
            with pytest.raises(BaseException) as caught, whole_folder(out) as folder:  # noqa: PT011, PT012
                write_text(folder / "design.json", "2\n")
                raise fault
            assert caught.type is (fault if isinstance(fault, type) else type(fault))
    check_whole(tmp_path / "out", 1)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_working_folder_keeps_its_place(tmp_path, monkeypatch):
    """A shell that stands in it would be left in a removed folder by an exchange."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    node = os.stat(".").st_ino
    write(".", 1, stale=True)
    write(".", 2)
    assert os.stat(".").st_ino == node == os.stat(tmp_path).st_ino
    check_whole(tmp_path, 2, **{"notes.txt": "mine"})


def test_a_folder_with_much_of_others_keeps_its_place(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "_MOST_CARRIED", 3)
    out = tmp_path / "home"
    out.mkdir()
    others = {f"{index}.txt": "mine" for index in range(5)}
    for name, text in others.items():
        (out / name).write_text(text)
    node = os.stat(out).st_ino
    write(out, 1)
    check_whole(out, 1, **others)
    assert os.stat(out).st_ino == node


def test_a_symbolic_link_stays_one(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    for number in (1, 2):
        write(tmp_path / "link", number)
        assert (tmp_path / "link").is_symlink()
        check_whole(tmp_path / "real", number)


def test_a_parent_that_is_read_only(tmp_path, monkeypatch):
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path and access(path, mode))
    (tmp_path / "out").mkdir()
    for number in (1, 2):
        write(tmp_path / "out", number)
        check_whole(tmp_path / "out", number)
    with pytest.raises(OutputError, match="read-only"):
        write(tmp_path / "other", 1)


def test_an_empty_folder_and_a_file_in_its_place(tmp_path, way):
    (tmp_path / "empty").mkdir(mode=0o750)
    write(tmp_path / "empty", 1)
    check_whole(tmp_path / "empty", 1)
    assert os.stat(tmp_path / "empty").st_mode & 0o777 == 0o750
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OutputError, match="not a folder"):
            write(out, 1)


# --- as processes --------------------------------------------------------------------------------

SCRIPT = f"""
import os, sys, time
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_folders import write, folders
from necc_casadi import folders
out, number, way, wait = sys.argv[1:]
if way == "file by file":
    folders._exchange = lambda one, other: False
print("ready", flush=True)
if wait:
    with folders.whole_folder(folders.Path(out)):
        print("inside", flush=True)
        time.sleep(60)
write(out, number, stale=True)
"""


def start(out, number, way="exchanged", wait=""):
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(out), str(number), way, wait],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_of_two_runs_in_one_folder_one_is_told(tmp_path):
    out = tmp_path / "out"
    first = start(out, 1, wait="wait")
    try:
        assert first.stdout.readline() == "ready\n"
        assert first.stdout.readline() == "inside\n"
        with pytest.raises(OutputError, match=rf"another run \(process {first.pid}\)"):
            write(out, 2)
    finally:
        first.kill()
        first.communicate()
    write(out, 2)  # the lock of a killed run holds nobody up, and its leftovers go
    check_whole(out, 2)


@pytest.mark.parametrize("text", ["", "1", "999999", "not a number"])
def test_a_lock_file_without_an_owner_holds_nobody_up(tmp_path, text):
    (tmp_path / ".out.necc-lock").write_text(text)
    write(tmp_path / "out", 1)
    check_whole(tmp_path / "out", 1)


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_killed_at_any_moment_of_putting_in_place(tmp_path, way):
    """SIGKILL 100 times: the old folder or the new one; file by file, or one that is refused."""
    out, dice = tmp_path / "out", random.Random(0)
    write(out, 0, stale=True)
    (out / "notes.txt").write_text("mine")
    span, finished, refused = 0.02, 0, 0  # s; it settles where half of the runs end in time
    for number in range(1, 101):
        child = start(out, number, way)
        assert child.stdout.readline() == "ready\n"
        time.sleep(span * dice.random())
        child.send_signal(signal.SIGKILL)
        child.communicate()
        try:
            refuse_unfinished(out)
        except OutputError:
            assert way == "file by file"
            refused += 1
        else:
            texts = {text for name, text in content(out).items() if name != "notes.txt"}
            assert len(texts) == 1, texts
            done = texts == {f"{number}\n"}
            finished, span = finished + done, span * (0.8 if done else 1.25)
        assert (out / "notes.txt").read_text() == "mine"
    assert 5 < finished < 95, "the moments were badly chosen"
    write(out, 1000, stale=True)
    check_whole(out, 1000, **{"notes.txt": "mine"})


CHANGES = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.chmod"}


def killed_at(call, out, number, way) -> bool:
    """A run in a forked process that ends before its n-th change of the file system."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    count = 0

    def end(event, arguments):
        nonlocal count
        creates = event == "open" and isinstance(arguments[2], int) and arguments[2] & os.O_CREAT
        count += event in CHANGES or bool(creates)
        if count == call:
            os._exit(9)

    def exchange(one, other):
        sys.audit("os.rename", one, other)
        done = way == "exchanged" and exchange_them(one, other)
        sys.audit("os.rename", one, other)
        return done

    exchange_them, folders._exchange = folders._exchange, exchange
    sys.addaudithook(end)
    write(out, number)
    os._exit(0)


def each_step(out, way) -> None:
    """Killed at every step in turn, and then run again."""
    refused, call, killed = 0, 0, True
    while killed:
        call += 1
        write(out, 0, stale=True)
        (out / "notes.txt").write_text("mine")
        killed = killed_at(call, out, 1, way)
        try:
            refuse_unfinished(out)
        except OutputError:
            refused += 1
        else:
            texts = {text for name, text in content(out).items() if name != "notes.txt"}
            assert texts in ({"0\n"}, {"1\n"}), (call, texts)
        assert (out / "notes.txt").read_text() == "mine", call
        write(out, 2)
        check_whole(out, 2, **{"notes.txt": "mine"})
    assert call > 20
    assert (refused > 0) == (way == "file by file")


@pytest.mark.parametrize("way", WAYS)
def test_killed_at_each_step(tmp_path, way):
    """In a process of its own, which has one thread to fork."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_folders; "
        f"test_folders.each_step(test_folders.Path({str(tmp_path / 'out')!r}), {way!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_folder_that_was_being_put_in_place_is_refused(tmp_path):
    out = tmp_path / "out"
    write(out, 1)
    (out / ".necc-new").mkdir()
    (out / ".necc-new" / ".necc-whole").write_text(json.dumps({"old": {}, "new": {"../x": ""}}))
    with pytest.raises(OutputError, match="was being put in place"):
        refuse_unfinished(out)
    with pytest.raises(OutputError, match="not readable"):
        write(out, 2)


def test_leftovers_that_are_not_certainly_ours_stay(tmp_path):
    out = tmp_path / "out"
    write(out, 1)
    place = tmp_path / ".out.necc-new"
    place.mkdir()
    (place / "design.json").write_text("who knows")
    with pytest.raises(OutputError, match="keeps a changed"):
        write(out, 2)
    assert (place / "design.json").read_text() == "who knows"
    check = content(out)
    assert check["design.json"] == "1\n"


def test_a_full_disk_leaves_the_old_folder(tmp_path):
    """A limit on the size of files stands for it: the same error, at the same calls."""
    out = tmp_path / "out"
    write(out, 1)
    code = f"""
import resource, sys
from necc_casadi.errors import OutputError
from necc_casadi.files import write_text
from necc_casadi.folders import whole_folder, Path
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with whole_folder(Path({str(out)!r})) as folder:
        write_text(folder / "c" / "necc.c", "2\\n")
        write_text(folder / "design.json", "2" * 2000)
except OutputError as problem:
    print(problem.fault)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.startswith(f"{out}{os.sep}design.json cannot be written"), done
    check_whole(out, 1)
