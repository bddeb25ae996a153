"""rows.csv: whole lines, whatever happens; a study goes on where it ended."""

import json

import pytest

from necc_casadi.errors import OutputError
from necc_casadi.study.rows import ROWS, STUDY, opened
from necc_casadi.study.tables import Table, write_tables

COLUMNS, ABOUT = ("a", "word"), {"study": "test"}


def fill(out, rows, count=4):
    with opened(out, COLUMNS, count, ABOUT) as kept:
        kept.add(rows)
        return kept.missing


def test_rows_are_kept_and_the_rest_is_missing(tmp_path):
    assert fill(tmp_path, [(2, [0.1, "x, y"]), (0, [None, True])]) == [1, 3]
    assert (tmp_path / ROWS).read_text() == 'row,a,word\n2,0.1,"x, y"\n0,,true\n'
    assert fill(tmp_path, [(2, [9.9, "again"]), (1, [1.0, "z"])]) == [3]
    assert (tmp_path / ROWS).read_text().count("\n2,") == 1


def test_a_line_of_any_length_that_was_torn_is_cut_off(tmp_path):
    """A run may be killed at any byte."""
    fill(tmp_path, [(0, [0.5, "x"]), (1, [0.25, "y"])])
    whole = (tmp_path / ROWS).read_bytes()
    for end in range(len(whole) + 1):
        (tmp_path / ROWS).write_bytes(whole[:end])
        missing = fill(tmp_path, [])
        lines = whole[:end].count(b"\n")
        assert missing == [[0, 1, 2, 3], [0, 1, 2, 3], [1, 2, 3], [2, 3]][lines]
        fill(tmp_path, [(k, row) for k, row in ((0, [0.5, "x"]), (1, [0.25, "y"])) if k in missing])
        assert (tmp_path / ROWS).read_bytes() == whole


def test_another_study_in_the_folder_is_left_alone(tmp_path):
    fill(tmp_path, [(0, [0.5, "x"])])
    before = (tmp_path / ROWS).read_bytes()
    with (
        pytest.raises(OutputError, match="holds another study"),
        opened(tmp_path, COLUMNS, 4, {"study": "other"}),
    ):
        pass
    assert (tmp_path / ROWS).read_bytes() == before
    assert json.loads((tmp_path / STUDY).read_text())["rows"] == 4


def test_a_file_of_somebody_else_is_left_alone(tmp_path):
    (tmp_path / ROWS).write_text("mine\n")
    with pytest.raises(OutputError, match="no study wrote it"):
        fill(tmp_path, [])
    assert (tmp_path / ROWS).read_text() == "mine\n"


def test_rows_that_were_changed_are_not_counted_as_ours(tmp_path):
    fill(tmp_path, [(0, [0.5, "x"])])
    (tmp_path / ROWS).write_text("row,a,word\n7,1,x\n")
    with pytest.raises(OutputError, match="changed by hand"):
        fill(tmp_path, [])


def test_two_runs_do_not_share_a_folder(tmp_path):
    with opened(tmp_path, COLUMNS, 4, ABOUT), pytest.raises(OutputError, match="another run"):
        fill(tmp_path, [])


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        fill(tmp_path / "file" / "out", [])


def test_tables_have_the_types_of_their_columns(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [["0", "1", "0.5", "true", "x", ""], ["1", "2", "", "false", "y", ""]]
    table = Table(("n", "v", "yes", "word", "none"), rows)
    files = write_tables(table, tmp_path)
    assert [path.name for path in files] == ["table.csv", "table.parquet"]
    read = parquet.read_table(tmp_path / "table.parquet").to_pydict()
    assert read == {
        "row": [0, 1], "n": [1, 2], "v": [0.5, None], "yes": [True, False], "word": ["x", "y"],
        "none": [None, None],
    }  # fmt: skip
    assert (tmp_path / "table.csv").read_text().splitlines()[2] == "1,2,,false,y,"
    assert table.numbers("yes").tolist() == [1, 0]
