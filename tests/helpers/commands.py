"""The commands, in this process and in one of their own."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

from necc_casadi.cli.design import _design
from necc_casadi.cli.terminal import run

DESIGN = "from necc_casadi.cli.design import design_command; design_command()"


CERTIFY = "from necc_casadi.cli.certify import certify_command; certify_command()"


SIMULATE = "from necc_casadi.cli.simulate import simulate_command; simulate_command()"


def process(code, *arguments, cwd, **options):
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True, text=True, cwd=cwd, timeout=120, **options,
    )  # fmt: skip


def here(command, *arguments):
    """The same command in this process: (exit code, stdout, stderr)."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(command, [*map(str, arguments)])
    return code, out.getvalue(), err.getvalue()


def design(*arguments):
    return here(_design, *arguments)


def without_progress(err):
    """Lines on stderr but those that name a stage on a slow machine."""
    return [line for line in err.splitlines() if not line.endswith(" ...")]


def check_refusal(result, code, piece=""):
    """Exit 2, JSON on stdout with the code word, two lines on stderr, no traceback."""
    status, out, err = result
    assert status == 2, err
    data = json.loads(out)
    assert set(data) == {"status", "error"}
    assert data["status"] == "error"
    assert data["error"]["code"] == code
    assert piece in data["error"]["message"]
    lines = without_progress(err)
    assert len(lines) == 2
    assert lines[0].startswith(f"error [{code}]: ")
    assert lines[1].startswith("  ")
    assert "Traceback" not in err
