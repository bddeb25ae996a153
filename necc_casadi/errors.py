"""Errors of input that cannot be used.

::

    NeccError
    └── InputError            exit code 2; carries a code word, the fault and what would work
        ├── ModelError        model file, its matrices, its parameters
        ├── TargetError       --target
        ├── OptionError       options of the command line or of the Python API
        └── OutputError       folders and files that cannot be written or read

Outcomes (a solver that stops early, a certificate that covers nothing, a
refusal) are values, not exceptions.
"""

from __future__ import annotations

__all__ = ["InputError", "ModelError", "NeccError", "OptionError", "OutputError", "TargetError"]


class NeccError(Exception):
    """Base of every exception that this package raises on purpose."""


class InputError(NeccError):
    """Input that cannot be used.

    Parameters
    ----------
    code
        Code word of docs/contract.md#errors, e.g. ``j_not_skew``.
    fault
        One line that names the entry at fault and its value.
    remedy
        One line that says what would work.
    """

    def __init__(self, code: str, fault: str, remedy: str) -> None:
        fault, remedy = " ".join(fault.splitlines()), " ".join(remedy.splitlines())
        super().__init__(f"{fault}\n{remedy}")
        self.code = code
        self.fault = fault
        self.remedy = remedy


class ModelError(InputError):
    """A model file, its matrices or its parameters cannot be used."""


class TargetError(InputError):
    """A target text cannot be used."""


class OptionError(InputError):
    """An option has a value that cannot be used."""


class OutputError(InputError):
    """A folder or file cannot be written, or is not what it should be."""
