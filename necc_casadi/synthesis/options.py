"""Options of the synthesis, and what they mean for the networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from necc_casadi.arrays import Vector
from necc_casadi.cases import Activation, CasimirForm, InitialXi, PhiForm, Shape
from necc_casadi.errors import OptionError
from necc_casadi.model.cost import QuadraticCost, bryson
from necc_casadi.model.sizes import Sizes

if TYPE_CHECKING:  # a verdict alone needs no CasADi
    from necc_casadi.lyapunov.networks import Network
    from necc_casadi.lyapunov.parameterization import Form

__all__ = ["Level", "Options", "Regulariser", "check_options", "form_of", "paper_options"]


@dataclass(frozen=True)
class Regulariser:
    """‖z − z*‖² ≤ γ (V(z) − V(z*)) on average over the domain is asked of V, natural units."""

    gamma: float = 1.0


@dataclass(frozen=True)
class Level:
    """What ends the region is raised: one critical point of V, else w on the domain's boundary."""


@dataclass(frozen=True)
class Options:
    """What a user may choose about a design; None means that the design chooses.

    Examples
    --------
    >>> from necc_casadi import Options
    >>> options = Options(hidden_k=(32, 32), starts=3)
    >>> options.activation, options.a is None
    ('tanh', True)
    """

    hidden_k: tuple[int, ...] = (64,)
    hidden_h: tuple[int, ...] = (32,)
    activation: Activation = "tanh"
    quadratic: bool = True  # adds a positive quadratic part to K and Hc
    casimir_form: CasimirForm = "joint"
    phi: PhiForm = "sum"
    a: float | None = None
    keep_a: bool = False  # ask for `a` even where no network can reach it
    D: Vector | None = None  # m × m
    Dc: Vector | None = None  # m × m
    least_cost: bool = False  # least quadratic cost of the linearised loop, damping included
    damping_alone: bool = False  # for the least cost the damping moves, V stays as trained
    rate: float | None = None  # 1/s that every mode is to exceed; with the least cost
    peak_u: Vector | None = None  # (m,) largest |u| from random starts, with the least cost
    state_cost: Vector | None = None  # n × n, of that cost; None: Bryson's rule
    input_cost: Vector | None = None  # m × m
    convex: bool = False  # quadratic parts stiff enough to make V convex everywhere
    whole: bool = False  # quadratic parts stiff enough for V to have one critical point
    learn_casimir: bool = False  # a network C(z), a Casimir only approximately
    polish: bool = False  # improve V and damping on responses, after everything else
    hold: float = 100.0  # then: what output layers cost to move, beside quadratic parts
    shape: Shape = "none"
    gamma: float | None = None  # of the regulariser; None: 1
    initial_xi: InitialXi | None = None  # where ξ starts; None: what is better in simulation
    natural_units: bool = True  # train in natural units, not in the model's
    seed: int = 0
    starts: int = 1
    verbose: bool = False

    @property
    def asks_for_cost(self) -> bool:
        """Whether V and damping are those of least cost: asked for, or by weights or a response.

        A damping that was given and a V that is shaped stay as they are.
        """
        asked = (self.rate, self.peak_u, self.state_cost, self.input_cost)
        fixed = self.D is not None or self.Dc is not None or self.shaping is not None
        return (self.least_cost or any(v is not None for v in asked)) and not fixed

    def cost(self, sizes: Sizes, n: int) -> QuadraticCost:
        """The weights that were given, else Bryson's, for n plant states, in the model's units."""
        default = bryson(sizes, n)
        return QuadraticCost(
            default.Q if self.state_cost is None else self.state_cost,
            default.R if self.input_cost is None else self.input_cost,
        )

    @property
    def shaping(self) -> Regulariser | Level | None:
        """What `shape` and `gamma` ask of V over the domain."""
        if self.shape == "regulariser":
            return Regulariser() if self.gamma is None else Regulariser(self.gamma)
        return Level() if self.shape == "level" else None


def paper_options(m: int) -> Options:
    """The published form (Section IV): plain tanh MLPs, Φ = H + Hc + C, a = 0.5, D = 5, Dc = 6.

    Parameters
    ----------
    m
        Number of inputs.

    Returns
    -------
    Options
        D and Dc are m × m.

    References
    ----------
    Xu, Zakwan and Ferrari-Trecate (2022).

    Examples
    --------
    >>> from necc_casadi import paper_options
    >>> options = paper_options(1)
    >>> options.hidden_k, options.hidden_h, options.a, options.D
    ((64,), (32,), 0.5, array([[5.]]))
    """
    return Options(
        quadratic=False,
        casimir_form="sum",
        a=0.5,
        natural_units=False,
        initial_xi="target",
        D=5.0 * np.eye(m),
        Dc=6.0 * np.eye(m),
    )


def check_options(options: Options) -> None:
    """Refuse options that do not go together.

    Raises
    ------
    OptionError
        For an unknown shape, a γ that is not positive, or a form that cannot be shaped.
    """
    if options.shape not in get_args(Shape):
        raise OptionError(
            "usage",
            f"--shape {options.shape} is not known",
            f"Choose from {', '.join(get_args(Shape))}.",
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
    _check_response(options)
    _check_polish(options)
    if options.shaping is None:
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


def _check_response(options: Options) -> None:
    """A rate and a peak are asked of the least-cost program, which has a form of its own."""
    asked = [
        name
        for name, value in (("a rate", options.rate), ("a peak of u", options.peak_u))
        if value is not None
    ]
    if not asked:
        return
    for clash, name in (
        *_other_forms(options),
        (options.shaping is not None, "--shape"),
        (options.D is not None or options.Dc is not None, "a given damping"),
    ):
        if clash:
            raise OptionError(
                "usage",
                f"{asked[0]} and {name} exclude each other",
                "Drop one: V and its damping are chosen for the response, with "
                "Φ = H + Hc + K(c₁, …, c_r).",
            )


def _other_forms(options: Options) -> tuple[tuple[bool, str], ...]:
    """What asks for another V than Φ = H + Hc + K(c₁, …, c_r) with quadratic parts."""
    return (
        (not options.quadratic, "--paper"),
        (options.phi != "sum", "--phi neural"),
        (options.casimir_form == "sum", "--casimir-form sum"),
        (options.learn_casimir, "--learn-casimir"),
    )


def _check_polish(options: Options) -> None:
    """Responses are improved for Φ = H + Hc + K(c₁, …, c_r), and for their cost alone."""
    if not options.polish:
        return
    for clash, name in (
        *_other_forms(options),
        (options.rate is not None, "a rate"),
        (options.peak_u is not None, "a peak of u"),
    ):
        if clash:
            raise OptionError(
                "usage",
                f"--polish and {name} exclude each other",
                "Drop one: --polish lowers the cost of responses, with Φ = H + Hc + K(c₁, …, c_r).",
            )


def form_of(options: Options, nc: int, r: int) -> Form:
    """The networks of V for nc controller states and r Casimirs."""
    from necc_casadi.lyapunov.networks import MonotonePhi, Network
    from necc_casadi.lyapunov.parameterization import Form

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
