"""The control law as a MATLAB function (MEX), by CasADi's code generator."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import casadi as ca

from necc_casadi.designs.design import Design
from necc_casadi.export.templating import PREFIX
from necc_casadi.files import write_text

__all__ = ["export_mex"]


def export_mex(design: Design, folder: Path, prefix: str = PREFIX) -> Path:
    """Write a C file for ``mex``: in MATLAB ``[u, xidot] = necc_control(x, xi)``, x as measured.

    With integral action ζ stands below ξ in xi, and its rate, not held within limits, in xidot.

    The file stands alone (``mex -largeArrayDims necc_control.c``) and has the function's name.
    It is the continuous law in double precision, for simulation beside MATLAB's own integrators;
    for Simulink and for hardware use ``necc.c`` or the FMI unit, which also keep ξ and the input
    limits.

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    law = design.measured_controller
    x, xi = law.mx_in()
    name = f"{prefix}_control"
    named = ca.Function(name, [x, xi], law.call([x, xi]), ["x", "xi"], ["u", "xidot"])
    generator = ca.CodeGenerator(f"{name}.c", {"mex": True})
    generator.add(named)
    with tempfile.TemporaryDirectory(prefix="necc-") as made:
        code = Path(generator.generate(made + os.sep))  # dump() leaves mexFunction out
        return write_text(Path(folder) / f"{name}.c", code.read_text(encoding="utf-8"))
