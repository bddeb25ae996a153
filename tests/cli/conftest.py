"""The main job, which several commands look at."""

import pytest
from helpers.commands import DESIGN, process
from helpers.problems import PENDULUM


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """The main job, once, as a process: (folder, its result)."""
    folder = tmp_path_factory.mktemp("job")
    own = folder / "pendulum-design"
    own.mkdir()
    (own / "notes.txt").write_text("mine")
    return folder, process(DESIGN, PENDULUM, "--target", "pi/4", cwd=folder)
