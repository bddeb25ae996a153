"""Files are written whole; JSON is strict, whatever the numbers."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from necc_casadi.errors import OutputError
from necc_casadi.files import check_writable, finite, to_json_text, write_text

DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def refuse(word):
    pytest.fail(f"{word} is not JSON")


@given(DATA)
def test_json_is_strict_and_loses_finite_numbers_of_no_data(data):
    text = to_json_text(data)
    assert "\n" not in text
    assert json.loads(text, parse_constant=refuse) == finite(data)


def test_numbers_that_are_not_finite_are_none_at_any_depth():
    data = {"a": (1.0, math.inf), "b": [{"c": math.nan}], "d": np.float64(-np.inf), "e": 1}
    assert finite(data) == {"a": [1.0, None], "b": [{"c": None}], "d": None, "e": 1}


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "below" / "file.txt"
    assert write_text(path, "first") == path
    write_text(path, b"second")
    assert path.read_text() == "second"
    with pytest.raises(OutputError, match="cannot be written"):
        write_text(path / "below", "third")
    assert [p.name for p in path.parent.iterdir()] == ["file.txt"]


def test_a_folder_below_a_file_is_refused_before_any_work(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="not a folder"):
        check_writable(tmp_path / "file" / "below")
    check_writable(tmp_path / "new" / "below")
    assert not (tmp_path / "new").exists()
