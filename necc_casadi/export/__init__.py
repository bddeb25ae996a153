"""The controller as C code, and what runs or wraps it."""

from necc_casadi.export.compiled import CompiledController, compile_controller, load_controller
from necc_casadi.export.source import INTEGRATORS, export_c

__all__ = [
    "INTEGRATORS",
    "CompiledController",
    "compile_controller",
    "export_c",
    "load_controller",
]
