"""From a judged target to a finished Design: networks, training, damping."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from necc_casadi.artifact import Design
from necc_casadi.assignability import Verdict
from necc_casadi.casimirs import Casimirs
from necc_casadi.certificate.region import domain_of, momentum_ceiling
from necc_casadi.certificate.structure import quadratic_states
from necc_casadi.conditions import at
from necc_casadi.convexity import least_kappa
from necc_casadi.damping import choose_damping
from necc_casadi.errors import OptionError
from necc_casadi.learned import casimir_penalty, casimir_residual, state_inputs
from necc_casadi.lifting import Scales
from necc_casadi.loop import ClosedLoop
from necc_casadi.lyapunov import Form, LyapunovFunction, make_terms
from necc_casadi.networks import KAPPA_MIN, MonotonePhi, Network, Vector
from necc_casadi.neutral import HELD_XI, NEUTRAL_STIFFNESS, best_coordinates, is_neutral
from necc_casadi.outcome import Start
from necc_casadi.plant import gradient
from necc_casadi.shaping import SHAPES, Box, Shaping, make_shaping
from necc_casadi.training import STIFFER, XI_COST, train

__all__ = ["Options", "check_options", "design", "natural_scales", "paper_options"]

#: Curvature asked for by default, as a share of the reference stiffness.
_DEFAULT_A = 0.5
#: Hidden layer of a learned Casimir: small enough for exact second derivatives.
_LEARNED_HIDDEN = (32,)
#: Share of the ceiling a_max that is asked for when the request lies beyond it.
_BELOW_CEILING = 0.9


@dataclass(frozen=True)
class Options:
    """What a user may choose about a design; None means that the design chooses."""

    hidden_k: tuple[int, ...] = (64,)
    hidden_h: tuple[int, ...] = (32,)
    activation: str = "tanh"
    quadratic: bool = True  # adds a positive quadratic part to K and Hc
    casimir_form: str = "joint"  # "sum": K(Σ βᵢ(cᵢ)), "joint": K(c₁, …, c_r)
    phi: str = "sum"  # "sum": Φ = H + Hc + C, "neural": MonotonePhi
    a: float | None = None
    keep_a: bool = False  # ask for `a` even where no network can reach it
    D: Vector | None = None  # m × m
    Dc: Vector | None = None  # m × m
    convex: bool = False  # quadratic parts stiff enough to make V convex everywhere
    learn_casimir: bool = False  # a network C(z), a Casimir only approximately
    shape: str = "none"  # what is asked of V over the domain: a key of SHAPES
    gamma: float | None = None  # of the regulariser: ‖z − z*‖² ≤ γ ΔV on average, natural units
    natural_units: bool = True  # scale the networks to the plant's domain and energy
    seed: int = 0
    starts: int = 1
    verbose: bool = False


def paper_options(m: int) -> Options:
    """The published form (Section IV): plain tanh MLPs, Φ = H + Hc + C, a = 0.5, D = 5, Dc = 6."""
    return Options(
        quadratic=False,
        casimir_form="sum",
        a=0.5,
        natural_units=False,
        D=5.0 * np.eye(m),
        Dc=6.0 * np.eye(m),
    )


def design(
    loop: ClosedLoop,
    casimirs: Casimirs,
    verdict: Verdict,
    x_star: Mapping[sp.Symbol, sp.Expr],
    options: Options | None = None,
    report: Callable[[Start], None] | None = None,
) -> Design:
    """Train V at x* and choose the damping.

    The design that is returned was written to text and read back, so that whatever is proved,
    simulated or exported is what is stored.

    Parameters
    ----------
    loop, casimirs, verdict
        Closed loop, its closed-form Casimirs and the verdict at x*.
    x_star
        Target, exact, plant symbols to values.
    options
        Form of the networks and what to ask of them.
    report
        Called with the outcome of each start of the solver.
    """
    options = options or Options()
    check_options(options)
    casimirs = _finite_at(casimirs, x_star)
    if options.learn_casimir:
        casimirs = state_inputs(loop, casimirs)
        options = replace(options, casimir_form="joint", hidden_k=_LEARNED_HIDDEN)
    elif not casimirs.functions:  # constants are Casimirs of every loop: C = K(0) keeps one form
        casimirs = replace(casimirs, functions=(sp.Integer(0),))
        options = replace(options, hidden_k=(1,))
    terms = make_terms(loop, casimirs)
    form = _form(options, terms.nc, terms.r)
    x = np.array([float(sp.N(x_star[s], 20)) for s in loop.plant.x])
    guess = np.zeros(terms.nc)
    if verdict.xi_star is not None:
        guess = np.array([float(sp.N(v, 20)) for v in verdict.xi_star])
    neutral = (
        options.quadratic and form.phi is None and not form.betas and is_neutral(loop, casimirs)
    )
    if neutral:
        guess = best_coordinates(terms, x, guess, natural_scales(loop, casimirs, x, guess))
    natural = natural_scales(loop, casimirs, x, guess)
    scales = natural if options.natural_units else Scales(np.ones(len(loop.z)), 1.0)
    z_guess = np.concatenate([x, guess])
    penalty = None
    if options.learn_casimir:
        penalty = casimir_penalty(terms, form, natural, z_guess, options.seed)
    requested = options.a if options.a is not None else _default_a(natural, verdict)
    a = requested
    if verdict.a_max is not None and requested >= verdict.a_max and not options.keep_a:
        a = _BELOW_CEILING * verdict.a_max
    kappa_min = least_kappa(terms, scales, verdict, x, guess, a) if options.convex else KAPPA_MIN
    stiffness: tuple[float, ...] | None = NEUTRAL_STIFFNESS if neutral else None
    if kappa_min > KAPPA_MIN:
        stiffness = (STIFFER * kappa_min,) * len(form.networks)
    untrained = Design(
        loop=loop,
        casimirs=casimirs,
        x_star=tuple(x_star[s] for s in loop.plant.x),
        verdict=verdict,
        form=form,
        weights=np.zeros(form.size),
        xi_star=guess,
        D=np.eye(terms.m),
        Dc=np.eye(terms.m),
        a=a,
        a_requested=requested,
        seed=options.seed,
    )
    solution = train(
        terms,
        form,
        x,
        a=a,
        scales=scales,
        seed=options.seed,
        starts=options.starts,
        xi_guess=guess,
        kappa_min=kappa_min,
        stiffness=stiffness,
        xi_cost=HELD_XI if neutral else XI_COST,
        penalty=penalty,
        shaping=None if options.shape == "none" else _shaping(untrained, natural, options),
        report=report,
        verbose=options.verbose,
    )
    z_star = np.concatenate([x, solution.xi_star])
    undamped = LyapunovFunction(terms, form, solution.weights, np.eye(terms.m), np.eye(terms.m))
    D, Dc = choose_damping(undamped, loop, z_star, options.D, options.Dc)
    made = replace(
        untrained,
        weights=solution.weights,
        xi_star=solution.xi_star,
        D=D,
        Dc=Dc,
        starts=solution.starts,
        learned=casimir_residual(terms, form, solution.weights, natural, z_star, options.seed)
        if options.learn_casimir
        else None,
    )
    return Design.from_text(made.text)


def check_options(options: Options) -> None:
    """Refuse options that do not go together.

    Raises
    ------
    OptionError
        For an unknown shape, a γ that is not positive, or a form that cannot be shaped.
    """
    if options.shape not in SHAPES:
        raise OptionError(
            "usage", f"--shape {options.shape} is not known", f"Choose from {', '.join(SHAPES)}."
        )
    if options.gamma is not None and options.shape != "regulariser":
        raise OptionError(
            "usage",
            f"--gamma {options.gamma:g} belongs to the regulariser, but the shape is "
            f"{options.shape}",
            "Add --shape regulariser, or drop --gamma.",
        )
    if options.gamma is not None and not 0 < options.gamma < np.inf:
        raise OptionError(
            "usage", f"--gamma {options.gamma} is not a positive number", "Try --gamma 1."
        )
    if options.shape == "none":
        return
    for clash, name, remedy in (
        (options.phi != "sum", "--phi neural", "Drop it: Φ = H + Hc + C can be shaped."),
        (options.learn_casimir, "--learn-casimir", "Drop one: nothing is certified from it."),
        (options.convex, "--global", "Drop one: V convex everywhere, or wide in the domain."),
    ):
        if clash:
            raise OptionError(
                "usage", f"--shape {options.shape} and {name} exclude each other", remedy
            )


def _shaping(untrained: Design, natural: Scales, options: Options) -> Shaping:
    """Samples of the domain around z*, momenta at rest, and what to ask of V there."""
    if untrained.form.betas:
        raise OptionError(
            "usage",
            f"--shape {options.shape} needs C = K(c₁, …, c_r), but the form is K(Σ βᵢ(cᵢ))",
            "Add --casimir-form joint.",
        )
    domain, resting = domain_of(untrained), quadratic_states(untrained)
    ceiling, _ = momentum_ceiling(untrained, resting, domain, 0.0)
    used = set().union(*(c.free_symbols for c in untrained.casimirs.functions))
    box = Box(
        lo=domain.lo - untrained.z_star,
        hi=domain.hi - untrained.z_star,
        active=tuple(i for i in range(untrained.loop.n) if i not in resting),
        shaped=tuple(
            i for i, s in enumerate(untrained.loop.z) if s in used or i >= untrained.loop.plant.n
        ),
        ceiling=ceiling if ceiling > 0 else np.inf,
        excess=lambda offsets: _excess(untrained, used, offsets),
    )
    gamma = 1.0 if options.gamma is None else options.gamma
    return make_shaping(
        options.shape, box, natural.state, natural.energy, untrained.a, gamma, options.seed
    )


def _excess(untrained: Design, used: Set[sp.Symbol], offsets: Vector) -> Vector:
    """H above its value with the states that no Casimir contains at the target, (S,).

    With Φ = H + Hc + C, V has this energy beyond what the networks give it; not finite where the
    model is not.
    """
    loop, terms = untrained.loop, untrained.lyapunov.terms
    shaped = [i for i, s in enumerate(loop.plant.x) if s in used]
    x = offsets[:, : terms.n].T + untrained.z_star[: terms.n, None]
    still = np.repeat(untrained.z_star[: terms.n, None], x.shape[1], axis=1)
    still[shaped] = x[shaped]
    H = terms.H.map(x.shape[1])
    return np.asarray(H(x) - H(still), float).ravel()


def _finite_at(casimirs: Casimirs, x_star: Mapping[sp.Symbol, sp.Expr]) -> Casimirs:
    """The Casimirs without poles at the target: V must be smooth there."""
    singular = (sp.zoo, sp.nan, sp.oo, -sp.oo)
    finite = [c for c in casimirs.functions if not c.subs(x_star).has(*singular)]
    if len(finite) == len(casimirs.functions):
        return casimirs
    kept = [casimirs.functions.index(c) for c in finite]
    origins = tuple(casimirs.origins[i] for i in kept) if casimirs.origins else ()
    return replace(casimirs, functions=tuple(finite), origins=origins)


def _form(options: Options, nc: int, r: int) -> Form:
    def network(inputs: int, hidden: tuple[int, ...], quadratic: bool) -> Network:
        return Network(inputs, hidden, options.activation, quadratic)

    joint = options.casimir_form == "joint" or r == 1
    betas = () if joint else tuple(network(1, options.hidden_k, False) for _ in range(r))
    return Form(
        hc=network(nc, options.hidden_h, options.quadratic),
        k=network(
            r if joint else 1,
            options.hidden_k,
            options.quadratic and not options.learn_casimir,
        ),
        betas=betas,
        phi=MonotonePhi() if options.phi == "neural" else None,
    )


def natural_scales(loop: ClosedLoop, casimirs: Casimirs, x_star: Vector, xi: Vector) -> Scales:
    """Sizes of the states from the domain (half-width 2 is one unit), of H from its curvature.

    A controller state without a domain of its own takes the size that the Casimirs give it.
    """
    domain = loop.plant.domain
    size = np.full(len(loop.z), np.nan)
    for index, name in enumerate(loop.states):
        if name in domain:
            lo, hi = (float(bound) for bound in domain[name])
            size[index] = (hi - lo) / 4
    n = loop.plant.n
    size[:n] = np.where(np.isnan(size[:n]), 1.0, size[:n])
    point = dict(zip(loop.z, np.concatenate([x_star, xi]), strict=True))
    slopes = np.array(
        [[abs(float(v)) for v in at(gradient(c, loop.z), point)] for c in casimirs.functions]
    )
    reach = np.max(slopes[:, :n] * size[:n], axis=1, initial=0.0)
    for index in map(int, np.flatnonzero(np.isnan(size))):
        seen = float(reach @ slopes[:, index])
        if seen > 0:
            size[index] = seen / float(slopes[:, index] @ slopes[:, index])
    size[np.isnan(size)] = 1.0
    pairs = zip(loop.plant.grad_H, loop.plant.x, strict=True)
    second = at(sp.Matrix([sp.diff(slope, s) for slope, s in pairs]), point)
    curvature = [abs(float(v)) for v in second]
    energies = size[:n] ** 2 * np.array(curvature)
    energy = float(energies[energies > 0].mean()) if np.any(energies > 0) else 1.0
    return Scales(size, energy)


def _default_a(scales: Scales, verdict: Verdict) -> float:
    """Half of the reference stiffness, and no more than half of the ceiling."""
    a = _DEFAULT_A * float(scales.stiffness.min())
    if verdict.a_max is not None:
        a = min(a, 0.5 * verdict.a_max)
    return float(f"{a:.3g}")
