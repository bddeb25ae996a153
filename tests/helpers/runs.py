"""Runs of necc-design, by their JSON."""

import json

from helpers.commands import design
from helpers.problems import PENDULUM

EXAMPLES = PENDULUM.parent
SMALL = ("--hidden-k", "8", "--hidden-h", "6")


def run(*arguments):
    """(exit code, JSON object) of one design."""
    code, text, err = design(*arguments, "--json")
    assert "Traceback" not in err
    return code, json.loads(text)
