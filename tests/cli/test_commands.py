"""python -m necc_casadi, completion, colours."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.problems import PENDULUM

from necc_casadi.cli.commands import COMMANDS

BIN = Path(sys.executable).parent


def module(*arguments, cwd=None, **environment):
    return subprocess.run(
        [sys.executable, "-m", "necc_casadi", *map(str, arguments)],
        capture_output=True, text=True, cwd=cwd, env={**os.environ, **environment}, timeout=120,
    )  # fmt: skip


def test_every_command_under_one_name(tmp_path):
    shown = module("--help")
    assert shown.returncode == 0
    for name in COMMANDS:
        assert re.search(rf"^  {name} ", shown.stdout, re.MULTILINE)
        own = module(name, "--help")
        assert own.returncode == 0, own.stderr
        assert own.stdout.startswith(f"Usage: python -m necc_casadi {name} ")
    done = module("design", PENDULUM, "--target", "pi/4", "--check", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith("Pendulum: the target is assignable")
    wrong = module("desing")
    assert wrong.returncode == 2
    assert len(wrong.stderr.splitlines()) == 2
    assert "No such command 'desing'" in wrong.stderr


def test_every_command_is_installed():
    import tomllib

    project = tomllib.loads((PENDULUM.parent.parent / "pyproject.toml").read_text("utf-8"))
    scripts = project["project"]["scripts"]
    assert scripts == {
        f"necc-{name}": f"necc_casadi.cli.{name}:{name}_command" for name in COMMANDS
    }


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_options(shell):
    """As the README says: the script that a shell sources, and what it asks for then."""
    code = "import sys; sys.argv[0] = 'necc-design'; from necc_casadi.cli.design import *; "
    code += "design_command()"
    environment = {**os.environ, "_NECC_DESIGN_COMPLETE": f"{shell}_source"}
    if shell != "bash":  # click asks the bash that is there for its version
        script = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environment
        )
        assert "_NECC_DESIGN_COMPLETE" in script.stdout
    environment |= {
        "_NECC_DESIGN_COMPLETE": f"{shell}_complete",
        "COMP_WORDS": "necc-design --pol",
        "COMP_CWORD": "--pol" if shell == "fish" else "1",
    }
    asked = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment
    )
    assert "--polish" in asked.stdout
    assert "--paper" not in asked.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals there")
@pytest.mark.parametrize("plain", [True, False])
def test_no_color_is_kept(tmp_path, plain):
    """On a terminal the progress is coloured; with NO_COLOR it is not."""
    import pty

    reader, writer = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"}
    environment |= {"TERM": "xterm-256color", **({"NO_COLOR": "1"} if plain else {})}
    done = subprocess.Popen(
        [sys.executable, "-m", "necc_casadi", "design", str(PENDULUM), "--target", "pi/4",
         "--check"],
        stdout=subprocess.PIPE, stderr=writer, cwd=tmp_path, env=environment,
    )  # fmt: skip
    os.close(writer)
    said = b""
    try:
        while piece := os.read(reader, 4096):
            said += piece
    except OSError:  # the other end is closed
        pass
    out = done.communicate(timeout=120)[0]
    os.close(reader)
    assert done.returncode == 0
    assert b"\x1b" not in out
    coloured = re.search(rb"\x1b\[(\d+;)*(3|9)\d", said)
    assert (coloured is None) == plain
