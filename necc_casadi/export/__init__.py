"""The controller as C code, and what runs or wraps it."""

from necc_casadi.export.c_project import export_c
from necc_casadi.export.compiled import CompiledController, compile_controller, load_controller
from necc_casadi.export.fmu import export_fmu
from necc_casadi.export.matlab import export_mex
from necc_casadi.export.sampled_loop import SampledLoop, analyse_sampling

__all__ = [
    "CompiledController",
    "SampledLoop",
    "analyse_sampling",
    "compile_controller",
    "export_c",
    "export_fmu",
    "export_mex",
    "load_controller",
]
