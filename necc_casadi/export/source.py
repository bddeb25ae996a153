"""The C controller of a design: ``necc.h``, ``necc.c``, a closed-loop demonstration, CMake.

Lemma 1 in the form that is exported, with γᵢ = Φ₂ ∂C/∂cᵢ and Φ₁ from the networks:

    ∂V/∂x = Φ₁ ∇H + Σ γᵢ ∂cᵢ/∂x,   ∂V/∂ξ = Φ₁ ∇Hc + Σ γᵢ ∂cᵢ/∂ξ
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np

from necc_casadi.artifact import Design, write_text
from necc_casadi.errors import OptionError
from necc_casadi.export.leaves import Real, leaf
from necc_casadi.export.networks_c import LANES, CNetwork, c_network, kernels, width
from necc_casadi.export.sampling import analyse_sampling, largest_stable_time
from necc_casadi.export.templating import comment, fill, indent
from necc_casadi.export.vectors import test_vectors
from necc_casadi.expressions import identifiers

__all__ = ["INTEGRATORS", "Source", "export_c"]

#: Methods that advance ξ over one sample, x held: option -> how the header calls it.
INTEGRATORS = {
    "euler": "Euler's method",
    "heun": "Heun's method",
    "rk4": "the classical Runge-Kutta method",
}


def export_c(
    design: Design,
    folder: Path,
    *,
    real: str = "double",
    sample_time: float | None = None,
    integrator: str = "heun",
    certificate_hash: str | None = None,
    claims: Sequence[str] = (),
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
        A key of :data:`INTEGRATORS`.
    certificate_hash, claims
        Hash of certificate.json and what it claims, for the header.

    Raises
    ------
    OptionError
        For an unknown type or integrator, or a sample time that is not positive.
    OutputError
        When a file cannot be written.
    """
    source = Source(design, real, sample_time, integrator, certificate_hash, tuple(claims))
    return [write_text(Path(folder) / name, text) for name, text in source.files.items()]


@dataclass(frozen=True, eq=False)
class Source:
    """The C texts of one design with the options of :func:`export_c`."""

    design: Design
    real: str = "double"
    sample_time: float | None = None  # s
    integrator: str = "heun"
    certificate_hash: str | None = None
    claims: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.real not in ("double", "float"):
            raise OptionError("usage", f"real = {self.real!r}", "Use double or float.")
        if self.integrator not in INTEGRATORS:
            raise OptionError(
                "usage", f"integrator = {self.integrator!r}", f"Use {', '.join(INTEGRATORS)}."
            )
        if self.sample_time is not None and not 0 < self.sample_time < np.inf:
            raise OptionError(
                "usage", f"the sample time is {self.sample_time}", "Give seconds, above 0."
            )

    @cached_property
    def files(self) -> dict[str, str]:
        """File name -> content."""
        return {
            "necc.h": self.header,
            "necc.c": self.controller,
            "main.c": self.demonstration,
            "test_vectors.h": self.vectors,
            "selftest.c": fill("selftest.c"),
            "CMakeLists.txt": fill("CMakeLists.txt"),
        }

    # --- necc.h ---------------------------------------------------------------------------------

    @property
    def header(self) -> str:
        """``necc.h``."""
        design = self.design
        n, nc, m = self._dimensions
        certificate, sample = self.certificate_hash, self.sample_time
        return fill(
            "necc.h",
            title=comment(design.loop.plant.name),
            target=comment(
                ", ".join(
                    f"{name} = {float(value):.6g}"
                    for name, value in zip(design.loop.plant.states, design.x_star, strict=True)
                )
            ),
            claims=self._claims,
            design_hash=design.hash,
            certificate_define=f'#define NECC_CERTIFICATE "{certificate}"' if certificate else "",
            n=n,
            nc=nc,
            m=m,
            sample_define=(
                f"#define NECC_SAMPLE_TIME {self._real.literal(sample)} /* s */" if sample else ""
            ),
            sampling=self._sampling,
            limits="" if design.loop.plant.u_limits else "; never: the model has no limits",
            order=self._order,
            real=self.real,
            integrator_name=INTEGRATORS[self.integrator],
        )

    @property
    def _sampling(self) -> str:
        """What the header says about the sample time."""
        if self.sample_time is None:
            return ""
        result = analyse_sampling(self.design, self.sample_time, self.integrator)
        radius = f"spectral radius {result.spectral_radius:.6g}"
        lines = [f"Sampled loop, linearised at its equilibrium: {radius}"]
        if result.largest_stable is not None:
            lines.append(f"stable up to {result.largest_stable:.3g} s")
        if result.warning is not None:
            lines.append(f"WARNING: {result.warning}")
        return "\n/* " + ";\n * ".join(lines) + ". */"

    @property
    def _claims(self) -> str:
        if not self.claims:
            return ": nothing; no certificate came with it."
        about = " (of the continuous-time loop with\n * exact arithmetic, u not saturated):"
        return about + "".join(f"\n *   - {comment(claim)}" for claim in self.claims)

    @property
    def _order(self) -> str:
        loop = self.design.loop

        def lines(array: str, names: Sequence[str]) -> list[str]:
            units = [loop.plant.units.get(name, "") for name in names]
            return [
                f" *   {array}[{i}]  {comment(name)}" + (f" [{comment(unit)}]" if unit else "")
                for i, (name, unit) in enumerate(zip(names, units, strict=True))
            ]

        inputs = [f"input {i + 1}" for i in range(loop.plant.m)]
        return "\n".join(
            lines("x", loop.plant.states) + lines("xi", loop.controller.states) + lines("u", inputs)
        )

    # --- necc.c ---------------------------------------------------------------------------------

    @property
    def controller(self) -> str:
        """``necc.c``."""
        networks, real = self.networks, self._real
        return fill(
            "necc.c",
            lanes=LANES,
            width=width(networks),
            literal="literal##f" if real.suffix else "literal",
            weights="\n".join(network.tables(real) for network in networks),
            kernels=kernels(networks, real),
            networks="\n".join(network.function(real) for network in networks),
            leaves="\n".join(self._leaves),
            parts=indent("\n".join(self._parts)),
            shape=indent("\n".join(self._shape)),
            law_arguments=", ".join(self._law_arguments),
            integrator=fill(f"{self.integrator}.c"),
            saturation=self._saturation,
            saturate="saturate(u)" if self._saturation else "NECC_OK",
            xi_star=real.literals(self.design.xi_star),
            init_at=self._init_at,
        )

    @cached_property
    def networks(self) -> list[CNetwork]:
        """The networks in the layout of the C code."""
        form = self.design.form
        names = ["hc", "k", *(f"beta{i + 1}" for i in range(len(form.betas)))]
        names += ["phi"] if form.phi is not None else []
        triples = zip(names, form.networks, form.split(self.design.weights), strict=True)
        return [c_network(*triple) for triple in triples if triple[1].inputs > 0]

    @property
    def _leaves(self) -> list[str]:
        """Casimirs, H where Φ is neural, and the law of Lemma 1 given the networks' slopes."""
        terms, (n, nc, _), real = self.design.lyapunov.terms, self._dimensions, self._real
        x, xi = ca.SX.sym("x", n), ca.SX.sym("xi", nc)
        c = terms.c(ca.vertcat(x, xi))
        leaves = []
        if terms.r:
            leaves.append(leaf("casimirs", [("x", x), ("xi", xi)], [("c", c)], real))
        if self._neural_phi:
            leaves.append(leaf("hamiltonian", [("x", x)], [("H", terms.H(x))], real))
        grad_hc, gamma = ca.SX.sym("grad_hc", nc), ca.SX.sym("gamma", terms.r)
        phi_1 = ca.SX.sym("phi_1") if self._neural_phi else ca.SX(1)
        grad_H, G, Gc = terms.grad_H(x), terms.G(x), terms.Gc(xi)
        V_x = phi_1 * grad_H + ca.jtimes(c, x, gamma, True)
        V_xi = phi_1 * grad_hc + ca.jtimes(c, xi, gamma, True)
        u = -Gc.T @ grad_hc - ca.DM(self.design.D) @ (G.T @ V_x)
        v_c = -ca.DM(self.design.Dc) @ (Gc.T @ V_xi)
        xi_dot = terms.Fc(xi) @ grad_hc + Gc @ (G.T @ grad_H + v_c)
        inputs = {"grad_hc": grad_hc, "gamma": gamma, "phi_1": phi_1}
        arguments = [("x", x), ("xi", xi)] + [(a, inputs[a]) for a in self._slopes]
        leaves.append(leaf("control_law", arguments, [("u", u), ("xidot", xi_dot)], real))
        leaves.append(leaf("energy_slope", arguments, [("gradient", V_xi)], real))
        return leaves

    @property
    def _saturation(self) -> str:
        limits = self.design.loop.plant.u_limits
        if limits is None:
            return ""
        low, high = (self._real.literals(side) for side in zip(*limits, strict=True))
        return fill("saturation.c", low=low, high=high)

    @property
    def _init_at(self) -> str:
        real = self._real
        return fill(
            "init_at.c",
            law_arguments=", ".join(self._law_arguments),
            cbrt_eps=real.literal(float(f"{real.eps ** (1 / 3):.1g}")),
            tiny=real.literal(float(f"{4 * real.eps:.1g}")),
            sqrt=f"sqrt{real.suffix}",
            fabs=f"fabs{real.suffix}",
        )

    @property
    def _slopes(self) -> list[str]:
        names = ["grad_hc"] + (["gamma"] if self.design.lyapunov.terms.r else [])
        return names + (["phi_1"] if self._neural_phi else [])

    @property
    def _law_arguments(self) -> list[str]:
        return [f"s.{name}" for name in self._slopes]

    @property
    def _parts(self) -> list[str]:
        """Members of ``shape_terms``."""
        r = self.design.lyapunov.terms.r
        return [
            "necc_real value; /* V" + (" */" if self._neural_phi else " - H(x) */"),
            "necc_real grad_hc[NECC_NXI];",
            *([f"necc_real gamma[{r}]; /* Phi_2 dC/dc */"] if r else []),
            *(["necc_real phi_1[1];"] if self._neural_phi else []),
        ]

    @property
    def _shape(self) -> list[str]:
        """Body of ``shape``: the networks at (x, ξ), put together by the chain rule."""
        terms, form = self.design.lyapunov.terms, self.design.form
        r = terms.r
        declarations = ["necc_real hc_value, casimir = R(0.0);"]
        body = ["hc_value = hc(xi, s->grad_hc);"]
        if r:
            declarations.append(f"necc_real c[{r}];")
            body.append("casimirs(x, xi, c);")
        if r and not form.betas:
            body.append("casimir = k(c, s->gamma);")
        elif r:
            declarations += ["necc_real sum, slope;", "int i;"]
            body += [
                f"sum = {' + '.join(f'beta{i + 1}(c + {i}, s->gamma + {i})' for i in range(r))};",
                "casimir = k(&sum, &slope);",
                f"for (i = 0; i < {r}; ++i)",
                "    s->gamma[i] *= slope;",
            ]
        if not self._neural_phi:
            body.append("s->value = hc_value + casimir;")
            return declarations + ([] if r else ["(void)x;"]) + body
        declarations.append("necc_real H, point[2], slopes[2];")
        body += [
            "hamiltonian(x, &H);",
            "point[0] = H + hc_value;",
            "point[1] = casimir;",
            "s->value = phi(point, slopes);",
            "s->phi_1[0] = slopes[0];",
        ]
        if r:
            if "int i;" not in declarations:
                declarations.append("int i;")
            body += [f"for (i = 0; i < {r}; ++i)", "    s->gamma[i] *= slopes[1];"]
        return declarations + body

    # --- main.c and test_vectors.h --------------------------------------------------------------

    @property
    def demonstration(self) -> str:
        """``main.c``."""
        terms, (n, _, m), real = self.design.lyapunov.terms, self._dimensions, self._real
        x, u = ca.SX.sym("x", n), ca.SX.sym("u", m)
        x_dot = terms.F(x) @ terms.grad_H(x) + terms.G(x) @ u
        states = identifiers(self.design.loop.states)
        columns = [*states, *(f"u{i + 1}" for i in range(m))]
        return fill(
            "main.c",
            sample_time=f"{self._demo_time:.6g}",
            sample_literal=real.literal(self._demo_time),
            plant=leaf("plant", [("x", x), ("u", u)], [("xdot", x_dot)], real),
            rk4_fractions=real.literals((0, 0.5, 0.5, 1)),
            rk4_weights=real.literals((1 / 6, 1 / 3, 1 / 3, 1 / 6)),
            digits=9 if real.suffix else 17,
            x_start=real.literals(self._demo_start),
            steps=2000,
            columns="".join(f",{name}" for name in columns),
        )

    @property
    def vectors(self) -> str:
        """``test_vectors.h``."""
        return test_vectors(self.design, self._real, self.integrator, self._demo_time)

    @cached_property
    def _demo_time(self) -> float:
        """The sample time, or one far from the stability limit, in s."""
        if self.sample_time is not None:
            return self.sample_time
        largest = largest_stable_time(self.design, self.integrator)
        return float(f"{min(0.01, (largest or 0.1) / 10):.1g}")

    @property
    def _demo_start(self) -> list[float]:
        """A quarter of the way from the target to the lower end of the domain."""
        plant = self.design.loop.plant
        start = []
        for name, target in zip(plant.states, self.design.z_star, strict=False):
            low = plant.domain[name][0] if name in plant.domain else target - 2
            start.append(float(target + (float(low) - target) / 4))
        return start

    # --- shorthands -----------------------------------------------------------------------------

    @property
    def _dimensions(self) -> tuple[int, int, int]:
        terms = self.design.lyapunov.terms
        return terms.n, terms.nc, terms.m

    @property
    def _neural_phi(self) -> bool:
        return self.design.form.phi is not None

    @property
    def _real(self) -> Real:
        return Real(self.real)
