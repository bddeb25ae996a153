"""Write OUT/c: the controller, a demonstration, a self-test, CMake and a README."""

from __future__ import annotations

from pathlib import Path

from necc_casadi.cases import Integrator, Precision
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.export.controller import controller
from necc_casadi.export.demonstration import demonstration
from necc_casadi.export.header import header
from necc_casadi.export.readme import readme
from necc_casadi.export.source import Source
from necc_casadi.export.templating import PREFIX, fill
from necc_casadi.export.vectors import vector_table
from necc_casadi.files import write_text
from necc_casadi.model.parametric import Parametric

__all__ = ["export_c"]


def export_c(
    design: Design,
    folder: Path,
    *,
    real: Precision = "double",
    sample_time: float | None = None,
    integrator: Integrator = "heun",
    certificate: Certificate | None = None,
    prefix: str = PREFIX,
    parametric: Parametric | None = None,
    measured: bool = True,
) -> list[Path]:
    """Write the C controller of `design` into `folder` (OUT/c); return the files written.

    Parameters
    ----------
    design
        The finished design.
    folder
        Where the files go; each is written whole or not at all.
    real
        ``double`` or ``float``: the type of all numbers in the C code.
    sample_time
        Seconds between two calls of ``necc_step``, for the header and the demonstration.
    integrator
        ``heun``, ``euler`` or ``rk4``: how ξ advances over a sample with x held; ``casimir``: ξ
        follows x, where outputs are rates of functions of the states, with a `sample_time`.
    certificate
        What is proved of `design`, for the header, and the region for ``necc_margin``.
    prefix
        Every external name of the code begins with it, macros in capitals; the files keep
        their names.
    parametric
        The plant with its parameters as symbols, for the ``necc_margin`` of a certificate of
        integral action that is about many plants.
    measured
        Compile and time the code for the README, where a C compiler is.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    OptionError
        For an unknown type or integrator, one that does not fit the design, a sample time that is
        not positive, a prefix that is no beginning of a name in C, or the certificate of another
        design.
    OutputError
        When a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from necc_casadi import design, export_c, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> sorted(path.name for path in export_c(made, Path("c"), measured=False))[-3:]
    ['necc.h', 'selftest.c', 'test_vectors.h']
    """
    source = Source(design, real, sample_time, integrator, certificate, prefix, parametric)
    files = {
        "necc.h": header(source),
        "necc.c": controller(source),
        "main.c": demonstration(source),
        "test_vectors.h": vector_table(source),
        "selftest.c": source.named(fill("selftest.c")),
        "CMakeLists.txt": fill("CMakeLists.txt", prefix=prefix),
        "README.md": readme(source, measured=measured),
    }
    return [write_text(Path(folder) / name, text) for name, text in files.items()]
