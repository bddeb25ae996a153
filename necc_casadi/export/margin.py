"""``necc_margin``: how far a state is inside the region of the certificate.

    margin = (c − V(x, ξ))/(c − V(z̄)),   where s is in a marked cell; elsewhere −1.

The marked cells of a region are leaves of a grid that is halved again and again. On the Z-order
curve of its finest cells each leaf is one interval of codes; neighbours join. The table holds
these intervals in order, so that a state is found by halving the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.regions import Leaf, Region
from necc_casadi.export.casadi2c import c_function
from necc_casadi.export.integral_margin import integral_margin, integral_margin_obstacle
from necc_casadi.export.level_rounding import integral_rounding
from necc_casadi.export.source import Source
from necc_casadi.export.targets import moving_set
from necc_casadi.export.templating import fill

__all__ = [
    "has_margin",
    "margin_code",
    "margin_constants",
    "margin_declaration",
    "margin_of_region",
    "margin_takes_momenta",
]

#: Intervals of codes that the table may have, and bits of a code.
_MOST_RUNS, _MOST_BITS = 4096, 64


#: Spacings of the numbers next to 1 by which the box of integral action is smaller.
_ROUNDINGS = 64.0


def has_margin(source: Source) -> bool:
    """Whether the code has ``necc_margin``."""
    return _missing(source) is None


def _missing(source: Source) -> str | None:
    """Why there is no ``necc_margin``."""
    certificate, design = source.certificate, source.design
    if certificate is None:
        return "no certificate came with the design"
    region = certificate.region
    if design.integral is not None:
        return integral_margin_obstacle(design, certificate, source.parametric)
    if design.setpoints or design.told:
        moves = moving_set(source) is not None
        return None if moves else "nothing is proved of set-points, or rounding may be all of it"
    if region is None:
        if certificate.of_the_whole_space:
            return "what is proved holds from every state, below no level"
        return "no region is proved"
    if region.method == "curved":
        return "V is as low in other components: a way to the minimum tells, not a formula"
    if _bits(region) > _MOST_BITS or len(_runs(region)) > _MOST_RUNS:
        return f"the region takes more than {_MOST_RUNS} intervals of cells"
    return None


def margin_constants(source: Source) -> str:
    """What the header defines about the margin."""
    missing, certificate = _missing(source), source.certificate
    if missing is not None or certificate is None:
        return f"#define NECC_HAS_MARGIN 0 /* {missing} */"
    lines = ["#define NECC_HAS_MARGIN 1"]
    if margin_of_region(source) is None:
        return lines[0]
    levels = (
        ("LIMITS", certificate.level_u, "u keeps its limits"),
        ("CLIPPED", certificate.level_clipped, "limits of u change nothing that is claimed"),
    )
    for name, level, words in levels:
        if level is not None:
            least = source.number.literal(_least_margin(source, certificate, level))
            lines.append(f"#define NECC_MARGIN_{name} {least} /* from here on {words} */")
    return "\n".join(lines)


def margin_declaration(source: Source) -> str:
    """The prototype of ``necc_margin`` and what it says."""
    if not has_margin(source) or source.certificate is None:
        return ""
    made = source.design
    if made.integral is not None:
        found = integral_margin(made, source.certificate, source.parametric)
        sides = zip(*found.resting, strict=True) if found is not None else ()
        told = ", ".join(f"[{lo:.6g}, {hi:.6g}]" for lo, hi in sides)
        unknown = (
            " plant of the certificate and" if found and len(found.energy.potentials) > 1 else ""
        )
        return fill("margin_integral.h", resting=told, unknown=unknown)
    if made.setpoints or made.told:
        told = " and with the present parameters" if made.told else ""
        return fill("margin_target.h", told=told)
    return fill("margin.h")


def margin_of_region(source: Source) -> Region | None:
    """The region that ``necc_margin`` is about; None where it is about something else."""
    made, certificate = source.design, source.certificate
    other = made.integral is not None or made.setpoints or made.told
    if other or certificate is None or not has_margin(source):
        return None
    region = certificate.region
    return region if isinstance(region, Region) else None


def margin_code(source: Source) -> str:
    """``necc_margin`` with its table; that of set-points comes with these."""
    certificate, region = source.certificate, margin_of_region(source)
    if source.design.integral is not None and has_margin(source):
        return _integral_code(source)
    if region is None or certificate is None:
        return ""
    real = source.number
    level, height = _level(source, certificate)
    kept = [region.active[i] for i in region.kept]
    table = _table(source, region) if kept else ""
    shifts = source.shaped and any(i >= source.n for i in kept)
    momenta = margin_takes_momenta(source)
    held = ["\n    necc_real held[NECC_NXI];\n    shifted(x, xi, held);"] if shifts else []
    held += ["\n    necc_real at[NECC_NX];\n    model_state(x, at);"] if momenta else []
    place = f"{'at' if momenta else 'x'}, {'held' if shifts else 'xi'}"
    return fill(
        "margin.c",
        level=real.literal(level),
        height=real.literal(height),
        table=table,
        outside=f" || !marked({place})" if kept else "",
        held="".join(held),
        H="" if source.neural_phi else "H[1], ",
        energy="" if source.neural_phi else "hamiltonian(x, H);",
        value="s.value" if source.neural_phi else "(s.value + H[0])",
    )


def margin_takes_momenta(source: Source) -> bool:
    """Whether the cells of the region are in momenta, though q̇ is measured."""
    region = margin_of_region(source)
    if region is None or not source.measures_velocity:
        return False
    return any(source.n // 2 <= region.active[i] < source.n for i in region.kept)


def _integral_code(source: Source) -> str:
    """1 − W/c with the largest W of what is not known."""
    made, real = source.design, source.number
    if source.certificate is None:
        return ""
    found = integral_margin(made, source.certificate, source.parametric)
    if found is None:
        return ""
    x, room = ca.SX.sym("x", source.n), 1 - _ROUNDINGS * real.eps
    level = max(found.level - integral_rounding(found, real), real.tiny)
    low, high = found.resting
    return fill(
        "margin_integral.c",
        leaf=c_function("known_energy", [("x", x)], [("parts", found.known(x))], real),
        q_star=real.literals(found.q_star),
        xi_bar=real.literals(found.xi_bar),
        half=real.literals(found.half * room),
        low=real.literals(low),
        high=real.literals(high),
        weight=real.literals(found.weight),
        ends=len(found.energy.potentials),
        rest=real.literal(found.rest),
        level=real.literal(level),
    )


def _level(source: Source, certificate: Certificate) -> tuple[float, float]:
    """(c, c − V(z̄)) in the units of the model."""
    if certificate.level is None:
        raise ValueError("a region without a level")
    return certificate.level, certificate.level - source.design.V(source.design.z_bar)


def _least_margin(source: Source, certificate: Certificate, level: float) -> float:
    """The margin of {V = level}, rounded up to a number of the exported type."""
    real, (highest, height) = source.number, _level(source, certificate)
    exact = (highest - level) / height
    up = exact + 4 * real.eps * max(abs(highest) / height, exact) if exact > 0 else 0.0
    return min(up, 1.0)


def _table(source: Source, region: Region) -> str:
    """``marked``: whether s is in a marked cell."""
    real, box = source.number, region.box
    kept = [region.active[i] for i in region.kept]
    units = [float(source.design.units.state[i]) for i in kept]
    runs, bits = _runs(region), _bits(region)
    code = "uint32_t" if bits <= 32 else "uint64_t"
    suffix = "u" if bits <= 32 else "ull"
    rows = [f"{{{first}{suffix}, {last}{suffix}}}" for first, last in runs]
    places = [f"x[{i}]" if i < source.n else f"xi[{i - source.n}]" for i in kept]
    return fill(
        "marked.c",
        code=code,
        axes=len(kept),
        depth=_deepest(region) + _first_bits(region),
        count=real.literal(float(box.parts * 2 ** _deepest(region))),
        last=f"{box.parts * 2 ** _deepest(region) - 1}{suffix}",
        lo=real.literals(lo * unit for lo, unit in zip(box.lo, units, strict=True)),
        side=real.literals(side * unit for side, unit in zip(box.side, units, strict=True)),
        runs=len(runs),
        rows=_wrapped(rows),
        places=", ".join(places),
    )


def _wrapped(rows: Sequence[str]) -> str:
    lines, line = [], ""
    for row in rows:
        if line and len(line) + len(row) > 90:
            lines.append(line)
            line = ""
        line += f"{row}, " if line else f"    {row}, "
    return "\n".join(text.rstrip(" ") for text in [*lines, line]).rstrip(",")


def _deepest(region: Region) -> int:
    return max((depth for depth, _ in region.leaves), default=0)


def _first_bits(region: Region) -> int:
    """Bits of the index of a cell that is not halved."""
    return max(1, math.ceil(math.log2(region.box.parts)))


def _bits(region: Region) -> int:
    return len(region.kept) * (_deepest(region) + _first_bits(region))


def _runs(region: Region) -> list[tuple[int, int]]:
    """Intervals (first, last) of the codes of the finest cells that are marked, in order."""
    deepest, axes = _deepest(region), len(region.kept)
    result: list[tuple[int, int]] = []
    for first, last in sorted(_interval(leaf, deepest, axes) for leaf in region.leaves):
        if result and result[-1][1] + 1 == first:
            result[-1] = (result[-1][0], last)
        else:
            result.append((first, last))
    return result


def _interval(leaf: Leaf, deepest: int, axes: int) -> tuple[int, int]:
    """The codes of a cell's finest parts, which follow each other."""
    depth, index = leaf
    below = axes * (deepest - depth)
    first = _interleaved(index) << below
    return first, first + (1 << below) - 1


def _interleaved(index: Sequence[int]) -> int:
    """Bits of the indices in turn, the first axis lowest."""
    axes = len(index)
    return sum(
        ((i >> bit) & 1) << (axes * bit + axis)
        for axis, i in enumerate(index)
        for bit in range(int(i).bit_length())
    )
