"""``necc.h``: the interface, and what the design is and what is known about it."""

from __future__ import annotations

import textwrap

from necc_casadi.export.margin import margin_constants, margin_declaration
from necc_casadi.export.sampled_loop import analyse_sampling
from necc_casadi.export.source import Source
from necc_casadi.export.targets import target_constants, target_declarations, target_members
from necc_casadi.export.templating import comment, fill

__all__ = ["header"]


_METHODS = {
    "euler": "Euler's method",
    "heun": "Heun's method",
    "rk4": "the classical Runge-Kutta method",
}


#: The control law, published and of power shaping.
_LAWS = {
    False: """\
 *   (v, vc) = -damping (G' dV/dx, Gc' dV/dxi)
 *   u  = -Gc' grad Hc + v
 *   xi' = (Jc - Rc) grad Hc + Gc (y + vc),  y = G' grad H(x)""",
    True: """\
 *   (v, vc) = -damping (G' (dV/dx + dgamma dV/dxi), dV/dxi) at xi = gamma(x) + s
 *   u  = -alpha(x) grad Hc(xi) + v
 *   s' = vc
 *
 * What the code calls xi is s: the controller keeps how far xi is from gamma(x).""",
}


#: What the state holds of the last sample where ξ is integrated, and what ``necc_update`` does.
_HELD_MEMBERS = """\
    necc_real xidot[NECC_NXI]; /* at (x, xi) of the last sample */
    necc_real xi_rest[NECC_NXI]; /* what rounding leaves of xi: its value is xi + xi_rest */"""
_HELD_MOVED = "\n    int moved; /* whether xi has been advanced since xidot */"
_HELD_UPDATE = """\
/* xi advances over dt with the x of the last sample held (@method@); before the
 * first sample nothing does. @wind_up@
 * What rounding takes away from xi is kept and added the next time. One call for each period: what
 * is proved of the sampled loop is not proved of several. */"""


#: Why limits of u do not wind ξ up, by whether they scale damping that moves it.
_WIND_UP = {
    False: "The dynamics of xi use x alone, so that a limited u does not wind it up.",
    True: "Of damping that moves xi the limits leave the same share as of that in u.",
}


#: In the state, where they do.
_SHARE = "\n    necc_real share[1]; /* of damping that the limits of u left at the last sample */"


#: How u keeps limits that scale damping.
_SCALING = (
    "\n *"
    "\n * Limits of u scale damping: @what@ taken times the largest share up to 1 with which"
    "\n * u keeps to them."
)


#: The same where Casimirs are kept.
_KEPT_MEMBERS = """\
    necc_real kept[NECC_NXI]; /* of xi, where x does not enter: it is kept + kept_rest */
    necc_real kept_rest[NECC_NXI]; /* what rounding leaves of it */
    necc_real due; /* time for which damping has to be made up, s */"""
_KEPT_UPDATE = """\
/* dt passes. Casimirs are kept: at the next sample xi is what its x makes of them, whatever u was
 * between, and then goes down V(x, .) over the time that passed, in @steps@ steps, of no more than
 * @longest@ s. Before the first sample nothing happens. Several calls are one over their sum.
 * Nothing is proved of this sampled loop. */"""


#: In the state, with integral action.
_ZETA = "\n    necc_real zeta[NECC_NU]; /* integral action */"


#: What rounding leaves of ζ.
_ZETA_REST = "\n    necc_real zeta_rest[NECC_NU];"


#: What ``necc_start`` does.
_START = {
    "target": "as necc_init; returns NECC_OK",
    "linear": "as necc_init, and T (x0 - x at the target) on top;\n"
    " * not finite x0: as necc_init, and NECC_REJECTED",
    "minimum": "as necc_init_at",
}


def header(source: Source) -> str:
    """The text of ``necc.h``."""
    design, sample = source.design, source.sample_time
    plant = design.loop.plant
    targets = zip(plant.states, design.z_star, strict=False)
    certificate = source.certificate_hash
    define = f"#define NECC_SAMPLE_TIME {source.number.literal(sample)} /* s */" if sample else ""
    text = fill(
        "necc.h",
        title=comment(plant.name),
        law=_law(source),
        target=comment(", ".join(f"{name} = {value:.6g}" for name, value in targets)),
        claims=_claims(source),
        design_hash=design.hash,
        certificate_define=f'#define NECC_CERTIFICATE "{certificate}"' if certificate else "",
        n=source.n,
        nc=source.nc,
        m=source.m,
        sample_define=define,
        margin_constants=margin_constants(source),
        margin=margin_declaration(source),
        sampling=_sampling(source),
        limited="kept to its limits by scaling damping" if design.scales_damping else "clipped",
        limits="" if plant.u_limits else "; never: the model has no limits",
        start_text=_START[design.initial_xi],
        order=_order(source),
        measured=_measured(source),
        has_target=target_constants(source),
        r=target_members(source),
        set_target=target_declarations(source),
        has_integral=0 if design.integral is None else 1,
        zeta=_ZETA if design.integral else "",
        zeta_rest=_ZETA_REST if design.integral else "",
        real=source.real,
        **_update(source),
        guard=f"NECC_DESIGN_{design.hash[:16]}",
    )
    return source.named(text)


def _update(source: Source) -> dict[str, str]:
    """What the state holds for the next sample, and what ``necc_update`` does."""
    share = _SHARE if source.scales_rate else ""
    if source.kept is None:
        method = _METHODS[source.integrator]
        return {
            "members": _HELD_MEMBERS + share,
            "moved": _HELD_MOVED,
            "update_text": _HELD_UPDATE.replace("@method@", method).replace(
                "@wind_up@", _WIND_UP[source.scales_rate]
            ),
        }
    text = _KEPT_UPDATE.replace("@steps@", str(source.substeps))
    longest = f"{source.longest_due:.4g}"
    return {
        "members": _KEPT_MEMBERS + share,
        "moved": "",
        "update_text": text.replace("@longest@", longest),
    }


def _law(source: Source) -> str:
    law = _LAWS[source.shaped]
    integral = source.design.integral
    if integral is not None:
        gains, limits = (", ".join(f"{v:.6g}" for v in a) for a in (integral.gain, integral.limit))
        law += (
            "\n *"
            "\n * necc_step adds integral action: u less zeta, with q* the target and y = B' q',"
            "\n *   zeta' = Ki (B' (q - q*) + tau y) within its limits, zeta = 0 at the start,"
            f"\n *   tau = {integral.tau:.6g}, Ki = diag({gains}), limits {limits}"
        )
    if source.design.loop.plant.preliminary is not None:
        law = law.replace(" *   u  =", " *   w  =") + "\n *   u  = u0(x) + B(x) w"
    if source.design.scales_damping:
        law += _SCALING.replace("@what@", "v and vc are" if source.scales_rate else "v is")
    return law


def _claims(source: Source) -> str:
    if not source.claims:
        return ": nothing; no certificate came with it."
    about = " (of the continuous-time loop with\n * exact arithmetic, u not saturated):"
    if source.design.integral is not None:
        about = about[:-2] + "; all but the last with zeta = 0):"
    return about + "".join(f"\n{_item(comment(claim))}" for claim in source.claims)


def _item(text: str) -> str:
    return textwrap.fill(
        text, 96, initial_indent=" *   - ", subsequent_indent=" *     ", break_long_words=False
    )


def _sampling(source: Source) -> str:
    """What is known about the sample time, if there is one."""
    if source.sample_time is None:
        return ""
    result = analyse_sampling(source.design, source.sample_time, source.integrator)
    radius = f"spectral radius {result.spectral_radius:.6g}"
    lines = [f"Sampled loop, linearised at its equilibrium: {radius}"]
    if result.largest_stable is not None:
        lines.append(f"stable up to {result.largest_stable:.3g} s")
    if result.warning is not None:
        lines.append(f"WARNING: {result.warning}")
    local = "\n/* " + ";\n * ".join(lines) + ". */"
    return local + _sampled_claim(source)


def _sampled_claim(source: Source) -> str:
    """What is proved of the loop that this code makes, called with the time since the last call."""
    if source.sampled_claim is None:
        return ""
    near = source.disturbed_claim
    kept = " It does not cover rounding." if near is None else ""
    text = (
        "Proved of the sampled loop, where dt of necc_step is the time since the last call, 0 at "
        f"the first: {source.sampled_claim}.{kept}"
    )
    items = [text] if near is None else [text, f"Proved of this code, too: {near}."]
    lines = "\n".join(_item(comment(item)) for item in items)
    return f"\n/*\n{lines}\n */"


def _measured(source: Source) -> str:
    """What x of the functions is."""
    if not source.measures_velocity:
        return " * x is the state of the plant, all of it measured."
    return (
        " * x is measured: coordinates and their rates. Momenta of a model or of an observer will\n"
        " * not do: with other masses than the plant's they are not rates times masses."
    )


def _order(source: Source) -> str:
    loop = source.design.loop
    measured = source.design.measurement
    known = {**loop.plant.units, **measured.units}
    arrays = {"x": measured.names, "xi": loop.controller.states, "u": loop.plant.input_names}
    return "\n".join(
        f" *   {array}[{i}]  {comment(name)}{_unit(known.get(name))}"
        for array, names in arrays.items()
        for i, name in enumerate(names)
    )


def _unit(unit: str | None) -> str:
    return f" [{comment(unit)}]" if unit else ""
