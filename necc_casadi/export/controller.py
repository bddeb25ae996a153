"""``necc.c``: the law of Lemma EnergyCasimirControl and what advances ξ.

With γᵢ = Φ₂ ∂C/∂cᵢ and Φ₁ from the networks,

    ∂V/∂x = Φ₁ ∇H + Σ γᵢ ∂cᵢ/∂x,   ∂V/∂ξ = Φ₁ ∇Hc + Σ γᵢ ∂cᵢ/∂ξ.

The code keeps s, which is ξ itself in the published loop, and ξ − γ(x) in one of power shaping.
With ``casimir`` it reads ξ off x, and keeps ξ − γ(x) of the published loop (``kept_casimirs.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from necc_casadi.designs.integral import integral_rate
from necc_casadi.designs.law import Law, law_of
from necc_casadi.export.casadi2c import c_function
from necc_casadi.export.margin import (
    margin_code,
    margin_of_region,
    margin_takes_momenta,
)
from necc_casadi.export.networks import CNetwork, c_network, kernels, loop_sizes
from necc_casadi.export.source import Source
from necc_casadi.export.targets import moving_set, target_code
from necc_casadi.export.templating import fill, indent

__all__ = ["c_networks", "controller"]


#: In ``necc_update``, with integral action.
_INTEGRATE = "integrate(next.x, dt, next.zeta, next.zeta_rest);"


#: Body of ``necc_start`` where ξ does not start along with x(0).
_START = {
    "target": "(void)x0;\nnecc_init(state);\nreturn NECC_OK;",
    "minimum": "return necc_init_at(state, x0);",
}


def controller(source: Source) -> str:
    """The text of ``necc.c``."""
    networks, real = c_networks(source), source.number
    integral, target = _integral(source), target_code(source)
    text = fill(
        "necc.c",
        design_hash=source.design.hash,
        guard=f"NECC_DESIGN_{source.design.hash[:16]}",
        sizes=loop_sizes(networks),
        literal="literal##f" if real.suffix else "literal",
        weights="\n".join(network.tables(real) for network in networks),
        kernels=kernels(networks, real),
        networks="\n".join(network.function(real) for network in networks),
        leaves="\n".join(_leaves(source)),
        parts=indent(_parts(source)),
        shape=indent(_shape(source)),
        law_arguments=_members(source),
        share=_share(source, ""),
        share_parameter=", const necc_real share[1]" if source.scales_rate else "",
        **_update(source),
        **_limits(source, integral.pop("subtract") + target.pop("forward")),
        xi_star=real.literals(source.design.stored_star),
        init_at=_init_at(source),
        start=indent(_start(source)),
        margin=margin_code(source),
        **integral,
        **target,
    )
    return source.named(text)


def _update(source: Source) -> dict[str, str]:
    """How ξ comes from one sample to the next."""
    kept, real = source.kept, source.number
    integrate = "" if source.design.integral is None else _INTEGRATE
    if kept is None:
        return {
            "integrator": fill(f"{source.integrator}.c", share=_share(source, "s->")),
            "update": fill("update_held.c", integrate=integrate, share=_share(source, "next.")),
            "rate_of": "xi' alone.",
            "arrive": "",
            "remember": "\n    (void)memcpy(next.xidot, xidot, sizeof xidot);\n    next.moved = 0;",
        }
    x = ca.SX.sym("x", source.n)
    gamma = kept.gamma(ca.densify(source.design.lyapunov.terms.measured.state(x)))
    leaf = c_function("integrated", [("x", x)], [("shift", gamma)], real)
    update = fill(
        "update_kept.c",
        steps=source.substeps,
        longest=real.literal(source.longest_due),
        share=_share(source, "s->"),
        integrate=integrate.replace("next.", "state->"),
    )
    return {
        "integrator": f"/* What xi is more than what is kept, at x. */\n{leaf}",
        "update": update,
        "rate_of": "What damping adds to the rate of xi.",
        "arrive": f"arrive(&next, {'at' if moving_set(source) else 'x'});\n    ",
        "remember": "",
    }


def _integral(source: Source) -> dict[str, str]:
    """What integral action adds: its code, and ζ before, in and after a sample."""
    design, real = source.design, source.number
    if design.integral is None:
        return dict.fromkeys(("integral", "counter", "subtract"), "")
    x, q_star = ca.SX.sym("x", source.n), design.z_star[: source.n // 2]
    rate = integral_rate(design.lyapunov, design.integral, q_star, measured=True)
    leaf = c_function("integral_rate", [("x", x)], [("rate", rate(x))], real)
    code = fill("integral.c", leaf=leaf, limit=real.literals(design.integral.limit))
    return {
        "integral": code,
        "counter": "\n    int i;",
        "subtract": "\n    for (i = 0; i < NECC_NU; ++i) {\n"
        f"        {source.asked}[i] -= state->zeta[i];\n    }}",
    }


def c_networks(source: Source) -> list[CNetwork]:
    """The networks of the design in the layout of the code."""
    form = source.design.form
    names = ["hc", "k", *(f"beta{i + 1}" for i in range(len(form.betas)))]
    names += ["phi"] if source.neural_phi else []
    triples = zip(names, form.networks, form.split(source.design.weights), strict=True)
    return [c_network(*t) for t in triples]


def _leaves(source: Source) -> list[str]:
    """Casimirs, H where Φ or the margin takes it, and the law given the networks' slopes."""
    design, real, law = source.design, source.number, law_of(source.design)
    arguments = [("x", law.x), ("xi", law.s), *law.slopes.items()]
    leaves = [c_function("casimirs", arguments[:2], [("c", law.casimirs)], real)]
    if source.shaped:
        leaves.append(c_function("shifted", arguments[:2], [("held", law.held)], real))
    if source.neural_phi or margin_of_region(source) is not None:
        H = design.lyapunov.terms.measured.H(law.x)
        leaves.append(c_function("hamiltonian", arguments[:1], [("H", H)], real))
    if needs_state(source):
        leaves.append(c_function("model_state", arguments[:1], [("state", law.state)], real))
    leaves.append(c_function("control_law", arguments, [("u", law.u), ("xidot", law.rate)], real))
    leaves.append(_state_rate(source, law, arguments))
    if design.scales_damping:
        results = [("resting", law.resting), ("pull", law.pull)]
        leaves.append(c_function("parted_law", arguments, results, real))
    leaves.append(c_function("energy_slope", arguments, [("gradient", law.V_xi)], real))
    return leaves


def _state_rate(source: Source, law: Law, arguments: Sequence[tuple[str, ca.SX]]) -> str:
    """The rate of what is kept, with the share of damping where limits scale that, too."""
    share = ca.SX.sym("share") if source.scales_rate else ca.SX(1)
    damped = share * law.damped
    moved = law.undamped + damped if source.kept is None else damped
    more = [("share", share)] if source.scales_rate else []
    return c_function("state_rate", [*arguments, *more], [("xidot", moved)], source.number)


def needs_state(source: Source) -> bool:
    """Whether something in the code is about momenta, though q̇ is measured."""
    linear = source.design.initial_gain is not None
    return source.measures_velocity and (linear or margin_takes_momenta(source))


def _slopes(source: Source) -> list[str]:
    """What the plant terms need of the networks."""
    return ["grad_hc", "gamma", *(["phi_1"] if source.neural_phi else [])]


def _members(source: Source) -> str:
    return ", ".join(f"s.{name}" for name in _slopes(source))


def _parts(source: Source) -> str:
    """Members of ``shape_terms``."""
    parts = ["necc_real value; /* V" + (" */" if source.neural_phi else " - H(x) */")]
    parts.append("necc_real grad_hc[NECC_NXI];")
    parts.append(f"necc_real gamma[{source.r}]; /* Phi_2 dC/dc */")
    if source.neural_phi:
        parts.append("necc_real phi_1[1];")
    return "\n".join(parts)


def _shape(source: Source) -> str:
    """Body of ``shape``: the networks at (x, ξ), put together by the chain rule."""
    variables, casimir = _casimir(source)
    if source.shaped:
        variables.append("necc_real held[NECC_NXI]; /* xi = gamma(x) + what is kept */")
    shift = ["shifted(x, xi, held);"] if source.shaped else []
    held = "held" if source.shaped else "xi"
    body = [*shift, f"hc_value = hc_network({held}, s->grad_hc);", *casimir]
    if source.neural_phi:
        variables.append("necc_real H, point[2], slopes[2];")
        body += [
            "hamiltonian(x, &H);",
            "point[0] = H + hc_value;",
            "point[1] = casimir;",
            "s->value = phi_network(point, slopes);",
            "s->phi_1[0] = slopes[0];",
            *(f"s->gamma[{i}] *= slopes[1];" for i in range(source.r)),
        ]
    else:
        body.append("s->value = hc_value + casimir;")
    return "\n".join([*variables, *body])


def _casimir(source: Source) -> tuple[list[str], list[str]]:
    """Variables and statements that give C and ∂C/∂c in the joint or the sum form."""
    r = source.r
    variables, body = [f"necc_real hc_value, casimir, c[{r}];"], ["casimirs(x, xi, c);"]
    if not source.design.form.betas:
        return variables, [*body, "casimir = k_network(c, s->gamma);"]
    terms = " + ".join(f"beta{i + 1}_network(&c[{i}], &s->gamma[{i}])" for i in range(r))
    scale = [f"s->gamma[{i}] *= slope;" for i in range(r)]
    return (
        [*variables, "necc_real sum, slope;"],
        [*body, f"sum = {terms};", "casimir = k_network(&sum, &slope);", *scale],
    )


def _limits(source: Source, added: str) -> dict[str, str]:
    """The law in ``necc_output``, with what is added to u, and how u keeps its limits."""
    limits, at = source.design.loop.plant.u_limits, "at" if moving_set(source) else "x"
    plain = {"law": f"necc_control({at}, next.xi, v, xidot);{added}", "parts_of_u": ""}
    if limits is None:
        return {**plain, "saturation": "", "saturate": "NECC_OK"}
    low, high = (source.number.literals(side) for side in zip(*limits, strict=True))
    if not source.design.scales_damping:
        text = fill("saturation.c", low=low, high=high)
        return {**plain, "saturation": text, "saturate": "saturate(u)"}
    law = fill(
        "law_scaled.c",
        at=at,
        members=_members(source),
        added=added.replace("\n    ", "\n"),
        share="next.share" if source.scales_rate else "share",
        of_rate=_share(source, "next."),
    )
    own = [] if source.scales_rate else ["necc_real share[1];"]
    parts = ["necc_real resting[NECC_NU], pull[NECC_NU];", *own, "shape_terms s;", "int flags;"]
    return {
        "law": indent(law).lstrip(),
        "parts_of_u": "".join(f"\n    {part}" for part in parts),
        "saturation": fill("scaling.c", low=low, high=high),
        "saturate": "flags",
    }


def _share(source: Source, of: str) -> str:
    """One more argument: the share of damping at the last sample, where it has to do with ξ."""
    return f", {of}share" if source.scales_rate else ""


def _start(source: Source) -> str:
    """Body of ``necc_start``."""
    gain, real = source.design.initial_gain, source.number
    if gain is None:
        return _START[source.design.initial_xi]
    x_star = real.literals(source.design.z_star[: source.n])
    return fill(
        "start_linear.c",
        x_star=x_star,
        gain=real.literals(gain.ravel()),
        momenta="\nnecc_real state_0[NECC_NX];" if source.measures_velocity else "",
        to_momenta="\nmodel_state(x0, state_0);" if source.measures_velocity else "",
        x="state_0" if source.measures_velocity else "x0",
    )


def _init_at(source: Source) -> str:
    real, sizes = source.number, source.design.sizes
    return fill(
        "init_at.c",
        xi_size=real.literals(sizes.state[source.n :]),
        V_size=real.literal(sizes.energy),
        stiffness=real.literals(sizes.stiffness[source.n :]),
        law_arguments=_members(source),
        cbrt_eps=real.literal(float(f"{real.eps ** (1 / 3):.1g}")),
        tiny=real.literal(float(f"{4 * real.eps:.1g}")),
        sqrt=f"sqrt{real.suffix}",
        fabs=f"fabs{real.suffix}",
    )
