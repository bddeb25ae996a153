"""Design: everything a finished design is, saved and loaded without ``eval`` and without pickle.

``design.json`` holds expressions as text and every float as an exact hexadecimal literal, so that a
loaded design is the saved one bit for bit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import numpy.typing as npt

from necc_casadi.arrays import Vector
from necc_casadi.casimirs.momenta import find_momenta
from necc_casadi.designs.initial import least_over_xi
from necc_casadi.designs.integral import with_integrators
from necc_casadi.designs.layout import BROKEN, DESIGN_FORMAT, check_whole, from_dict, to_dict
from necc_casadi.designs.natural import natural_parts
from necc_casadi.designs.parts import Parts
from necc_casadi.errors import OptionError, OutputError
from necc_casadi.files import refuse_unfinished, write_text
from necc_casadi.lyapunov.limits import limited_law, scales_damping
from necc_casadi.lyapunov.lyapunov import LyapunovFunction, make_terms
from necc_casadi.lyapunov.opened_loop import opened_at_the_input
from necc_casadi.model.domain import Domain, domain_of
from necc_casadi.model.measurement import Measurement
from necc_casadi.symbolic.floats import to_floats
from necc_casadi.verdict.verdict import STABLE

if TYPE_CHECKING:
    from necc_casadi.certificate.claims.certificate import Certificate

__all__ = ["Design", "refuse_other"]


#: A rate below this share of the fastest is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Design(Parts):
    """A finished design: model, Casimirs, verdict, weights, equilibrium and damping.

    Saved and loaded it is the same bit for bit (docs/certificate-format.md).

    Examples
    --------
    >>> from necc_casadi import Design, design, find_casimirs, judge, load_model, parse_target
    >>> loop = load_model("pendulum.py").loop
    >>> x_star = parse_target(loop.plant, "pi/4")
    >>> casimirs = find_casimirs(loop)
    >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
    >>> u, xi_dot = made.control(x=[0.1, 0.0], xi=[0.5])
    >>> u.shape, xi_dot.shape
    ((1,), (1,))
    >>> A, B, C, D = made.linearise()
    >>> A.shape, B.shape, C.shape, D.shape
    ((3, 3), (3, 2), (2, 3), (2, 2))
    >>> Design.load(made.save("design.json")).hash == made.hash
    True
    """

    def __reduce__(self) -> tuple[Callable[[str], Design], tuple[str]]:
        """Sent to another process as design.json has it, compiled functions made anew there."""
        return Design.from_text, (self.text,)

    @cached_property
    def domain(self) -> Domain:
        """The box of states (n + nc,) in which the design is looked at."""
        return domain_of(self.loop, self.z_star, self.sizes.state)

    @property
    def named_sizes(self) -> dict[str, float]:
        """Natural size of each state and input, by name."""
        names = (*self.loop.states, *self.loop.plant.input_names)
        values = np.concatenate([self.sizes.state, self.sizes.input])
        return dict(zip(names, values.tolist(), strict=True))

    @cached_property
    def natural(self) -> Design:
        """The same design in natural units, in which numbers are of order one."""
        return self if self.units.are_ones else Design(**vars(natural_parts(self)))

    @cached_property
    def momenta(self) -> tuple[int, ...]:
        """Indices of the plant states that are momenta; see :func:`find_momenta`."""
        if self.natural is not self:
            return self.natural.momenta
        return find_momenta(self.loop, self.casimirs, self.x_star)

    @cached_property
    def lyapunov(self) -> LyapunovFunction:
        """V, its derivatives, its control law and its closed loop."""
        terms = make_terms(self.loop, self.casimirs)
        return LyapunovFunction(terms, self.form, self.weights, self.damping)

    @cached_property
    def z_star(self) -> Vector:
        """(x*, ξ*) in double precision, (n + nc,)."""
        return np.concatenate([to_floats(self.x_star), self.xi_star])

    @cached_property
    def measurement(self) -> Measurement:
        """What the controller takes: the states of the plant, or (q, q̇)."""
        return Measurement(self.loop.plant)

    def control(self, x: npt.ArrayLike, xi: npt.ArrayLike) -> tuple[Vector, Vector]:
        """The controller: what is measured (n,), controller state (nc,) -> u (m,), ξ̇ (nc,).

        Measured are the plant's states, or (q, q̇): ``measurement.names``. The ζ of integral action
        comes off u; ``measured_controller`` has it with its rate.
        """
        return self.lyapunov.control_law(self.lyapunov.state(x), xi)

    def xi_at_start(self, x0: npt.ArrayLike) -> Vector:
        """ξ(0) of this design for the first measurement (n,), (nc,); ``necc_start`` in C."""
        return self.xi_at_state(self.lyapunov.state(x0))

    def xi_at_state(self, x0: npt.ArrayLike) -> Vector:
        """ξ(0) of this design for a plant state (n,), (nc,).

        With "target" the controller keeps at first what it keeps at z*, with "linear" T(x0 − x*) on
        top: ξ is γ(x0) more, which is 0 in the published loop.
        """
        x0, n = np.asarray(x0, float), self.loop.plant.n
        if self.initial_xi == "target":
            return self.stored_star + self.lyapunov.gamma(x0)
        if self.initial_xi == "linear" and self.initial_gain is not None:
            kept = self.stored_star + self.initial_gain @ (x0 - self.z_star[:n])
            return np.asarray(kept + self.lyapunov.gamma(x0), float)
        natural, x = self.natural, x0 / self.units.state[:n]
        return least_over_xi(natural.lyapunov, natural, x)[0] * self.units.state[n:]

    @cached_property
    def stored_star(self) -> Vector:
        """What the controller keeps at z*: ξ* − γ(x*), (nc,); ``necc_init`` in C."""
        return self.lyapunov.stored(self.z_star[: self.loop.plant.n], self.xi_star)

    def V(self, z: npt.ArrayLike) -> float:
        """The Lyapunov function at z = (x, ξ), (n + nc,)."""
        return float(self.lyapunov.V(z))

    def contains(self, z: npt.ArrayLike, certificate: Certificate) -> bool:
        """Whether a state z = (x, ξ), (n + nc,), is in the region Ω of this design's certificate.

        Plain evaluation of V, in the model's units; angles count as they stand. Ω is one component
        of {V ≤ c}: a state where V is as low may be in another. Where the whole space is proved
        and no region besides, every finite state is in it; where nothing is proved, none.

        Raises
        ------
        OptionError
            When the certificate is of another design.

        Examples
        --------
        >>> from necc_casadi import certify, design, find_casimirs, judge, load_model, parse_target
        >>> loop = load_model("pendulum.py").loop
        >>> x_star = parse_target(loop.plant, "pi/4")
        >>> casimirs = find_casimirs(loop)
        >>> made = design(loop, casimirs, judge(loop, casimirs, x_star), x_star)
        >>> certificate = certify(made)
        >>> made.contains(made.z_bar, certificate)
        True
        >>> made.contains([-1.0, 9.0, 0.0], certificate)
        False
        """
        refuse_other(self, certificate)
        return certificate.contains(self.V, np.asarray(z, float).tolist())

    @cached_property
    def z_bar(self) -> Vector:
        """The minimum of V near z*, by Newton's method on ∇V, (n + nc,)."""
        if self.natural is not self:
            return self.natural.z_bar * self.units.state
        z = self.z_star
        for _ in range(20):
            g, hessian = self.lyapunov.gradient(z), self.lyapunov.hessian(z)
            step = np.linalg.lstsq(hessian, g, rcond=None)[0]
            z = z - step
            if np.linalg.norm(step) <= 4 * np.finfo(float).eps * max(1.0, float(np.linalg.norm(z))):
                break
        return z

    @property
    def stored_z_bar(self) -> Vector:
        """(x̄, s̄), (n + nc,): the equilibrium in what the plant has and the controller keeps."""
        x, xi = np.split(self.z_bar, [self.loop.plant.n])
        return np.concatenate([x, self.lyapunov.stored(x, xi)])

    @cached_property
    def controller(self) -> ca.Function:
        """(x, kept) -> (u, rate): the law with what it keeps, s and the ζ of integral action."""
        k = self.loop.plant.n // 2
        return with_integrators(self.lyapunov, self.integral, self.z_star[:k])

    @cached_property
    def scales_damping(self) -> bool:
        """Whether limits of u scale the damping injection; else they clip each input by itself."""
        return scales_damping(self.loop.plant, self.damping)

    @cached_property
    def limited_controller(self) -> ca.Function:
        """(x, kept) -> (u, rate, what u would be without limits), u within those of the model."""
        k, limits = self.loop.plant.n // 2, self.loop.plant.u_limits
        resting = None
        if self.scales_damping:
            resting = with_integrators(self.lyapunov.resting, self.integral, self.z_star[:k])
        ends = (None, None) if limits is None else np.array(limits, float).T
        return limited_law(self.controller, resting, *ends)

    @cached_property
    def measured_controller(self) -> ca.Function:
        """The same at what is measured."""
        k = self.loop.plant.n // 2
        return with_integrators(self.lyapunov, self.integral, self.z_star[:k], measured=True)

    @cached_property
    def spectrum(self) -> npt.NDArray[np.complex128]:
        """Eigenvalues of the linearisation at z̄, (n + nc,), and m more with ζ, 1/s."""
        natural = self.natural
        A = natural.lyapunov.linearisation(natural.z_bar)
        if natural.integral is not None:
            A = natural._with_integral_action()
        return np.asarray(np.linalg.eigvals(A) / self.units.time, complex)

    def _with_integral_action(self) -> Vector:
        """∂/∂(x, ξ, ζ) of the loop at rest."""
        terms, n, m = self.lyapunov.terms, self.loop.plant.n, self.loop.plant.m
        w = ca.MX.sym("w", self.loop.n + m)
        u, rate = self.controller.call([w[:n], w[n:]])
        slope = ca.vertcat(terms.drift(w[:n]) + terms.directions(w[:n]) @ u, rate)
        jacobian = ca.Function("A", [w], [ca.jacobian(slope, w)])
        return np.asarray(jacobian(np.concatenate([self.z_bar, np.zeros(m)])), float)

    @property
    def abscissa(self) -> float:
        """Largest real part of the spectrum, 1/s; 0 where rounding may be all that it is."""
        largest, fastest = self.spectrum.real.max(), np.abs(self.spectrum).max()
        return 0.0 if abs(largest) <= _ROUNDING * fastest else float(largest)

    @property
    def decays(self) -> bool:
        """Whether every mode of the linearisation at z̄ decays."""
        return self.abscissa < 0

    @property
    def creeps(self) -> bool:
        """Whether motions may go to z̄ more slowly than a simulation can tell.

        Not every mode of the linearisation decays, and still z̄ may attract.
        """
        return not self.decays and self.verdict.stability != STABLE

    def linearise(self) -> tuple[Vector, Vector, Vector, Vector]:
        """State-space matrices (A, B, C, D) of the damped loop at z̄, ready for python-control.

        The loop is closed: it is looked at through the ports of damping injection. Inputs are
        (v, v_c) on top of the damping, outputs are (y, y_c) = 𝒢ᵀ∇(H + Hc), which in the published
        loop are y = Gᵀ∇H and y_c = Gcᵀ∇Hc: A (n + nc)², B (n + nc) × 2m, C 2m × (n + nc), D = 0.
        Margins of the controller are those of :meth:`loop_transfer`, which opens the loop at the
        plant's input.
        """
        z = self.z_bar
        values = dict(zip(self.loop.z, z, strict=True))
        B = np.array(self.loop.ports.subs(values).evalf(), dtype=float)
        return (
            self.lyapunov.linearisation(z),
            B,
            self._port_jacobian(z),
            np.zeros((B.shape[1],) * 2),
        )

    def loop_transfer(self) -> tuple[Vector, Vector, Vector, Vector]:
        """State-space matrices (A, B, C, D) of L(s) at z̄, the loop opened at the plant's input.

        An input w of the plant makes the controller give u = −L(s) w, so that the loop is closed
        by negative feedback, as python-control has it: ``control.StateSpace(*loop_transfer())``.
        States are (x, s) with s = ξ − γ(x), ξ itself in the published loop: A (n + nc)²,
        B (n + nc) × m, C m × (n + nc), D = 0; A − BC is the closed loop.
        """
        S, U, T = self.units.state, self.units.input, self.units.time
        natural = self.natural
        A, B, C = opened_at_the_input(natural.lyapunov, natural.z_bar)
        m = self.loop.plant.m
        return (
            A * S[:, None] / S / T,
            B * S[:, None] / U / T,
            C * U[:, None] / S,
            np.zeros((m, m)),
        )

    def _port_jacobian(self, z: Vector) -> Vector:
        terms = self.lyapunov.terms
        s = ca.MX.sym("z", z.size)
        energy = self.form.controller_energy(ca.DM(self.weights))(s[terms.n :])
        slope = ca.gradient(terms.H(s[: terms.n]) + energy, s)
        y = terms.ports(s).T @ slope
        return np.asarray(ca.Function("C", [s], [ca.jacobian(y, s)])(z), float)

    @cached_property
    def text(self) -> str:
        """The exact content of design.json."""
        return json.dumps(to_dict(self), indent=1, ensure_ascii=False) + "\n"

    @cached_property
    def hash(self) -> str:
        """SHA-256 of design.json."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def save(self, path: str | Path) -> Path:
        """Write design.json at `path`, whole or not at all, and return the path.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        return write_text(Path(path), self.text)

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """Read a design.json, or the folder that holds one.

        Raises
        ------
        OutputError
            When there is none, or it is not a design of this format.
        """
        path = Path(path)
        if path.is_dir():
            refuse_unfinished(path)
            path = path / "design.json"
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            reason = problem.strerror if isinstance(problem, OSError) else "not UTF-8 text"
            raise OutputError(
                "output", f"{path} cannot be read: {reason}", "Name a folder of necc-design."
            ) from None
        return cls.from_text(text, str(path))

    @classmethod
    def from_text(cls, text: str, label: str = "design.json") -> Design:
        """Rebuild a design from the content of design.json; `label` names it in errors.

        Raises
        ------
        OutputError
            When it is not a design of this format.
        """
        remedy = f"Design it again; this version reads format {DESIGN_FORMAT}."
        try:
            data = json.loads(text)
            if data.get("format") != DESIGN_FORMAT:
                raise OutputError("output", f"{label} has format {data.get('format')!r}", remedy)
            parts = from_dict(data)
            check_whole(parts, data)
            return cls(**vars(parts))
        except BROKEN as problem:
            raise OutputError("output", f"{label} is not a design: {problem!r}", remedy) from None


def refuse_other(design: Design, certificate: Certificate) -> None:
    """Raise an OptionError when the certificate is of another design."""
    if certificate.design_hash != design.hash:
        raise OptionError(
            "usage",
            "certificate: it is of another design",
            "Give the one that certify(design) made.",
        )
