"""The controller as an FMI 2.0 co-simulation unit: the same C, a thin wrapper, a description."""

from __future__ import annotations

import io
import platform
import re
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from necc_casadi.arrays import Vector
from necc_casadi.cases import Integrator, Precision
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.export.compiled import compile_shared, find_compiler
from necc_casadi.export.controller import controller
from necc_casadi.export.header import header
from necc_casadi.export.margin import has_margin
from necc_casadi.export.source import Source
from necc_casadi.export.targets import moving_set
from necc_casadi.export.templating import PREFIX, fill
from necc_casadi.files import write_text
from necc_casadi.model.parametric import Parametric
from necc_casadi.symbolic.identifiers import identifiers
from necc_casadi.texts import escaped

__all__ = ["export_fmu"]


_SOURCES = ("necc.c", "fmu.c")


_EPOCH = (2000, 1, 1, 0, 0, 0)  # the same design gives the same archive


def export_fmu(
    design: Design,
    path: Path,
    *,
    real: Precision = "double",
    sample_time: float | None = None,
    integrator: Integrator = "heun",
    certificate: Certificate | None = None,
    prefix: str = PREFIX,
    parametric: Parametric | None = None,
) -> Path:
    """Write `path`, sources included, and a binary for this machine where a C compiler is.

    The options are those of :func:`export_c`; `sample_time` is the suggested step.

    Raises
    ------
    OptionError
        As :func:`export_c`.
    OutputError
        When the compiler fails or the file cannot be written.
    """
    source = Source(design, real, sample_time, integrator, certificate, prefix, parametric)
    guid = f"{{{design.hash[:32]}}}"
    linear = design.initial_xi == "linear"
    wrapper = fill(
        "fmu.c",
        guid=guid,
        x_star=source.number.literals(_at_target(source)),
        start_at_minimum=int(design.initial_xi == "minimum"),
        otherwise="as necc_start has it" if linear else "at the equilibrium",
        start_otherwise="necc_start(&self->state, self->x)" if linear else "NECC_OK",
    )
    texts = {"necc.h": header(source), "necc.c": controller(source), "fmu.c": source.named(wrapper)}
    path = Path(path)
    name = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
    files: dict[str, str | bytes] = {"modelDescription.xml": _description(source, guid, name)}
    files |= {f"sources/{file}": text for file, text in texts.items()}
    compiler = find_compiler()
    if compiler is not None:
        folder, suffix = _platform()
        files[f"binaries/{folder}/{name}{suffix}"] = _binary(compiler, texts)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as bundle:
        for file, content in files.items():
            bundle.writestr(zipfile.ZipInfo(file, _EPOCH), content, zipfile.ZIP_DEFLATED)
    return write_text(path, archive.getvalue())


def _at_target(source: Source) -> Vector:
    """What is measured at the target, (n,)."""
    return source.design.lyapunov.measured(source.design.z_star[: source.n])


def _platform() -> tuple[str, str]:
    """Folder and suffix that FMI 2.0 gives binaries of this machine."""
    systems = {"win32": ("win", ".dll"), "darwin": ("darwin", ".dylib")}
    system, suffix = systems.get(sys.platform, ("linux", ".so"))
    bits = platform.architecture()[0][:2]
    if platform.machine().lower() not in ("x86_64", "amd64", "i386", "i686"):
        return f"{platform.machine()}-{system}", suffix
    return system + bits, suffix


def _binary(compiler: str, texts: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="necc-") as build:
        folder, target = Path(build), Path(build) / "fmu.so"
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        sources = [folder / name for name in _SOURCES]
        compile_shared(compiler, sources, target, ["-O2", "-fvisibility=hidden"])
        return target.read_bytes()


def _description(source: Source, guid: str, name: str) -> str:
    """``modelDescription.xml``; its order of variables fixes the value references in fmu.c."""
    design = source.design
    loop = design.loop
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=escaped(loop.plant.name),
        guid=guid,
        generationTool="necc-casadi",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    unit = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
    )
    files = ET.SubElement(unit, "SourceFiles")
    for file in _SOURCES:
        ET.SubElement(files, "File", name=file)
    measured = design.measurement
    known = {**design.loop.plant.units, **measured.units}
    names = (*measured.names, *design.loop.plant.input_names)
    units = [escaped(known.get(name, "")) for name in names]
    definitions = dict.fromkeys(unit for unit in units if unit)
    if definitions:
        parent = ET.SubElement(root, "UnitDefinitions")
        for text in definitions:
            ET.SubElement(parent, "Unit", name=text)
    ET.SubElement(root, "DefaultExperiment", stepSize=repr(source.step_time))
    _variables(root, source, units)
    _structure(root, source)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _variables(root: ET.Element, source: Source, units: Sequence[str]) -> None:
    """x, u, ξ, ζ, margin, r, θ, flags, switch, start; the order fixes the references in fmu.c."""
    design, loop, at_target = source.design, source.design.loop, _at_target(source)
    margin = ["margin"] if has_margin(source) else []
    variables = ET.SubElement(root, "ModelVariables")
    outputs = [*source.input_columns, *loop.controller.states, *source.zeta_names, *margin]
    targets, told = _targets(source), _told(source)
    names = identifiers(
        [*design.measurement.names, *outputs, *targets, *told, "flags", *_switch(source),
         "start_at_minimum"]
    )  # fmt: skip
    reals, rest = names[: -2 - len(_switch(source))], names[-2 - len(_switch(source)) :]

    def add(name: str, reference: int, kind: str, attributes: dict[str, str], **words: str) -> None:
        common = {"name": name, "valueReference": str(reference), **words}
        ET.SubElement(ET.SubElement(variables, "ScalarVariable", common), kind, attributes)

    given = {"causality": "input", "variability": "continuous"}
    made = {"causality": "output", "variability": "continuous", "initial": "calculated"}
    kept = {"causality": "parameter", "variability": "tunable"}
    kinds = [given] * loop.plant.n + [made] * len(outputs) + [given] * len(targets)
    starts = [*at_target, *[None] * len(outputs), *at_target[: len(targets)], *told.values()]
    kinds += [kept] * len(told)
    for i, (name, words, start) in enumerate(zip(reals, kinds, starts, strict=True)):
        unit = {"unit": text} if i < len(units) and (text := units[i]) else {}
        value = {} if start is None else {"start": repr(float(start))}
        add(name, i, "Real", value | unit, **words)
    add(
        rest[0], 0, "Integer", {}, causality="output", variability="discrete", initial="calculated",
        description="1: u at its limits, 2: input not finite, 4: no minimum found, "
        "8: out of range, 16: moved part of the way, 32: not moved, "
        "64: not proved with this parameter",
    )  # fmt: skip
    for name in rest[1:-1]:
        add(
            name, 1, "Integer", {"start": "0"}, causality="parameter", variability="tunable",
            description="where the target or a parameter changes, 0: xi stays, 1: u stays, "
            "2: V(x, .) is least",
        )  # fmt: skip
    add(
        rest[-1], 0, "Boolean", {"start": str(design.initial_xi == "minimum").lower()},
        causality="parameter", variability="fixed",
        description="xi starts at the minimum of V(x, .)",
    )  # fmt: skip


def _targets(source: Source) -> list[str]:
    """Names of the set-points that may be commanded; none where they do not move."""
    if moving_set(source) is None or not source.design.setpoints:
        return []
    return [f"target_{name}" for name in source.design.loop.plant.states[: source.n // 2]]


def _told(source: Source) -> dict[str, float]:
    """Names of the parameters that may be told, with those of the model."""
    found = moving_set(source)
    if found is None:
        return {}
    return dict(zip(map(str, found.points.theta), found.told[2].tolist(), strict=True))


def _switch(source: Source) -> list[str]:
    return [] if moving_set(source) is None else ["change_of_xi"]


def _structure(root: ET.Element, source: Source) -> None:
    """U and the margin depend on x; ξ and the flags only at the start."""
    n, m, nc = source.n, source.m, source.nc + len(source.zeta_names)
    margin = {n + m + nc + 1} if has_margin(source) else set()
    structure = ET.SubElement(root, "ModelStructure")
    on_x = " ".join(str(i + 1) for i in range(n))
    last = n + m + nc + len(margin)
    flags = last + len(_targets(source)) + len(_told(source)) + 1
    for name in ("Outputs", "InitialUnknowns"):
        parent = ET.SubElement(structure, name)
        for index in (*range(n + 1, last + 1), flags):
            direct = name == "InitialUnknowns" or index <= n + m or index in margin
            words = {"index": str(index), "dependencies": on_x if direct else ""}
            ET.SubElement(parent, "Unknown", words)
