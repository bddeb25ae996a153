"""The plant ẋ = (J − R)∇H + G u, y = Gᵀ∇H (eq. Plant): structure checks and equilibria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import sympy as sp

from necc_casadi.errors import ModelError
from necc_casadi.model.control_affine import Equilibria, Preliminary
from necc_casadi.model.entries import (
    Property,
    check_states,
    check_structure,
    scalar_entry,
    shaped_matrix,
    square_matrix,
)
from necc_casadi.symbolic.derivatives import gradient

__all__ = ["Plant", "make_plant"]


@dataclass(frozen=True, eq=False)
class Plant(Equilibria):
    """A port-Hamiltonian plant, exact and checked (eq. Plant).

    Build one with :func:`make_plant`, which checks the structure. Quantities are in the units of
    the model. With preliminary feedback u = u₀(x) + B(x)ũ, J, R, G and H are the target structure
    that ũ sees; limits, sizes and units are those of u.

    References
    ----------
    van der Schaft (2017), chapter 6.

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import make_plant
    >>> q, p = sp.symbols("q p", real=True)
    >>> J, G = sp.Matrix([[0, 1], [-1, 0]]), sp.Matrix([0, 1])
    >>> plant = make_plant((q, p), J, sp.zeros(2, 2), G, p**2 / 2 + 1 - sp.cos(q))
    >>> plant.n, plant.m, plant.states
    (2, 1, ('q', 'p'))
    >>> plant.holding_input({q: sp.pi / 6, p: 0})
    Matrix([[1/2]])
    """

    name: str
    x: tuple[sp.Symbol, ...]  # (n,)
    J: sp.ImmutableMatrix  # n × n, skew-symmetric
    R: sp.ImmutableMatrix  # n × n, symmetric, ⪰ 0
    G: sp.ImmutableMatrix  # n × m, full column rank
    H: sp.Expr  # Hamiltonian, scalar
    units: Mapping[str, str] = field(default_factory=dict)  # name of a state or input -> unit
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] = field(default_factory=dict)
    u_limits: tuple[tuple[float, float], ...] | None = None  # (m,) pairs
    sizes: Mapping[str, sp.Expr] = field(default_factory=dict)  # name of a state or input -> size
    inputs: tuple[str, ...] = ()  # names, (m,); () for u, or u1 … um
    properties: tuple[Property, ...] = ()
    preliminary: Preliminary | None = None
    #: M(q), n/2 × n/2, where x = (q, p) with p = M q̇ and the controller takes (q, q̇); None: x
    inertia: sp.ImmutableMatrix | None = None

    @cached_property
    def grad_H(self) -> sp.ImmutableMatrix:
        """∇H, n × 1."""
        return gradient(self.H, self.x)

    @property
    def flow(self) -> sp.ImmutableMatrix:
        """(J − R)∇H, n × 1."""
        return sp.ImmutableMatrix((self.J - self.R) * self.grad_H)

    @property
    def drift(self) -> sp.ImmutableMatrix:
        """F of ẋ = f + g u, n × 1; (J − R)∇H where nothing is fed back ahead of the loop."""
        return self.flow if self.preliminary is None else self.preliminary.f

    @property
    def directions(self) -> sp.ImmutableMatrix:
        """g, n × m; G where nothing is fed back ahead of the loop."""
        return self.G if self.preliminary is None else self.preliminary.g


def make_plant(
    x: Sequence[sp.Symbol],
    J: sp.MatrixBase,
    R: sp.MatrixBase,
    G: sp.MatrixBase,
    H: sp.Expr,
    *,
    name: str = "plant",
    units: Mapping[str, str] | None = None,
    inputs: Sequence[str] = (),
    domain: Mapping[str, tuple[sp.Expr, sp.Expr]] | None = None,
    u_limits: Sequence[tuple[float, float]] | None = None,
) -> Plant:
    """Check the structure of eq. Plant and return the plant; numbers become exact rationals.

    Parameters
    ----------
    x
        States, n symbols.
    J, R, G
        Interconnection n × n, dissipation n × n and input matrix n × m, of x.
    H
        Hamiltonian, a scalar of x, in the unit of energy that the model is written in.
    name
        Title.
    units
        State or input to unit, for texts and plots.
    inputs
        Names of the inputs; by default u, or u1 … um.
    domain
        State to (lo, hi): where proofs, plots and random starts stay.
    u_limits
        One pair (lo, hi) per input.

    Returns
    -------
    Plant
        Exact and checked; what could not be proved for all x says so in its ``properties``.

    Raises
    ------
    ModelError
        With the code of the first property that fails: ``duplicate_state, shape, h_not_scalar,
        undefined_symbol, not_real, non_smooth, singular, h_constant, j_not_skew, r_not_symmetric,
        r_not_psd, g_rank, limits``; see docs/contract.md#errors.

    Examples
    --------
    >>> import sympy as sp
    >>> from necc_casadi import make_plant
    >>> q, p = sp.symbols("q p", real=True)
    >>> J, G = sp.Matrix([[0, 1], [-1, 0]]), sp.Matrix([0, 1])
    >>> plant = make_plant((q, p), J, sp.zeros(2, 2), G, p**2 / 2 + 1 - sp.cos(q))
    >>> [p.name for p in plant.properties if not p.proved]
    []
    >>> make_plant((q, p), sp.ones(2, 2), sp.zeros(2, 2), G, p**2)
    Traceback (most recent call last):
    necc_casadi.errors.ModelError: J must be skew-symmetric: J[0,0] + J[0,0] = 2
    Set J[0,0] = -J[0,0], so zero on the diagonal.
    """
    x = tuple(x)
    check_states(x, "x")
    n = len(x)
    H = _hamiltonian(H, x)
    interconnection, dissipation = square_matrix(J, n, "J", x), square_matrix(R, n, "R", x)
    ports = shaped_matrix(G, "G", x)
    if ports.rows != n or ports.cols == 0:
        raise ModelError(
            "shape",
            f"G has shape {ports.rows}×{ports.cols}, but x has {n} states",
            f"G needs {n} rows and one column per input.",
        )
    properties = check_structure(
        interconnection,
        dissipation,
        ports,
        code_skew="j_not_skew",
        code_symmetric="r_not_symmetric",
        code_psd="r_not_psd",
        code_rank="g_rank",
    )
    if inputs and len(inputs) != ports.cols:
        raise ModelError(
            "shape",
            f"inputs names {len(inputs)} inputs, but G has {ports.cols} columns",
            "Give one name per input.",
        )
    if u_limits is not None and len(u_limits) != ports.cols:
        raise ModelError(
            "limits",
            f"u_limits has {len(u_limits)} entries, but G has {ports.cols} columns",
            "Give one (lo, hi) pair per input.",
        )
    return Plant(
        name=name,
        x=x,
        J=interconnection,
        R=dissipation,
        G=ports,
        H=H,
        units=dict(units or {}),
        domain=dict(domain or {}),
        u_limits=None if u_limits is None else tuple(u_limits),
        inputs=tuple(inputs),
        properties=properties,
    )


def _hamiltonian(H: sp.Expr, x: tuple[sp.Symbol, ...]) -> sp.Expr:
    remedy = "H must be one scalar expression of the states."
    if isinstance(H, sp.MatrixBase):
        if H.shape != (1, 1):
            raise ModelError("h_not_scalar", f"H is a {H.rows}×{H.cols} matrix", remedy)
        H = H[0, 0]
    if not isinstance(H, (sp.Expr, int, float)) or isinstance(H, bool):
        raise ModelError("h_not_scalar", f"H = {H} is not a scalar expression", remedy)
    H = scalar_entry(H, "H", x)
    if not H.free_symbols:
        raise ModelError(
            "h_constant",
            f"H = {H} depends on no state",
            f"H must be the energy as a function of {', '.join(map(str, x))}.",
        )
    return H
