"""``python -m necc_casadi``: every command under one name."""

from __future__ import annotations

import sys

from necc_casadi.cli.commands import every_command
from necc_casadi.cli.terminal import run

if __name__ == "__main__":
    sys.exit(run(every_command))
