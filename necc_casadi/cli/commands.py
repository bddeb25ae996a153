"""All commands in one: ``python -m necc_casadi design pendulum.py --target pi/4``."""

from __future__ import annotations

from importlib import import_module

import click

__all__ = ["COMMANDS", "every_command"]


#: Each is in a file of its name, and loaded when it is asked for.
COMMANDS = {
    "design": "from a model and a target to a certified controller",
    "certify": "prove again, with other arithmetic, what a folder claims",
    "simulate": "one response of a saved design",
    "montecarlo": "one saved design on many plants",
    "sweep": "many designs of one model",
}


class _Commands(click.Group):
    """A group that knows its commands by name alone."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names, in order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """A command, loaded."""
        if name not in COMMANDS:
            return None
        command = getattr(import_module(f"necc_casadi.cli.{name}"), f"_{name}")
        return command if isinstance(command, click.Command) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """One line each, without loading any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group("python -m necc_casadi", cls=_Commands)
@click.version_option(package_name="necc-casadi", prog_name="necc-casadi")
def every_command() -> None:
    """Certified energy-Casimir controllers. Each command is also installed as necc-COMMAND."""
