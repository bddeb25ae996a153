"""Whether z̄ attracts: what must be proved, and what must never be."""

import sympy as sp
from helpers.constructed import (
    make_design,
    mechanical,
)

from necc_casadi.casimirs.casimirs import Casimirs
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.lyapunov.networks import Network
from necc_casadi.lyapunov.parameterization import Form
from necc_casadi.model.closed_loop import interconnect
from necc_casadi.model.controller import default_controller, make_controller
from necc_casadi.model.plant import make_plant


def holds(certificate: Certificate) -> dict[str, bool]:
    return {claim.name: claim.holds for claim in certificate.claims}


def local(design) -> Certificate:
    return certify(design, region=False)


def test_conserved_momentum_makes_the_loop_only_stable():
    """Free rigid body with one torque along a principal axis of a symmetric body."""
    p = sp.symbols("p1:4", real=True)
    J = sp.Matrix([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
    H = (p[0] ** 2 + p[1] ** 2) / 2 + p[2] ** 2
    plant = make_plant(p, J, sp.zeros(3), sp.Matrix([0, 0, 1]), H)
    # with no input coupling into the momentum norm there is nothing to certify here but V = H
    loop = interconnect(plant, default_controller(plant))
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    norm = p[0] ** 2 + p[1] ** 2 + p[2] ** 2
    design = make_design(
        plant, (0, 0, 0), form, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0],
        casimirs=Casimirs((norm,), 1, 1), loop=loop,
    )  # fmt: skip
    certificate = local(design)
    assert not holds(certificate)["casimir"]  # ‖p‖² is no Casimir of the controlled loop
    assert not certificate.certified


def test_undriven_conserved_casimir_is_named_as_the_reason():
    """An oscillator beside two frozen coordinates, which no input reaches."""
    q, p, a, b = sp.symbols("q p a b", real=True)
    J = sp.zeros(4)
    J[0, 1], J[1, 0] = 1, -1
    H = p**2 / 2 + q**2 / 2 + (a**2 + b**2) / 2
    plant = make_plant((q, p, a, b), J, sp.zeros(4), sp.Matrix([0, 1, 0, 0]), H)
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    loop = interconnect(plant, default_controller(plant))
    casimir = Casimirs((a,), 3, 3)
    design = make_design(
        plant, (0, 0, 0, 0), form, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0],
        casimirs=casimir, loop=loop,
    )  # fmt: skip
    certificate = local(design)
    assert certificate.stability == "stable"
    assert certificate.certified
    assert "conserves a" in certificate.claims[-1].statement


def test_neither_hurwitz_nor_conserved_is_undecided():
    """Two equal masses, actuated symmetrically: the difference never decays."""
    plant = mechanical(lambda q1, q2, p1, p2: (p1**2 + p2**2 + q1**2 + q2**2) / 2, 2, inputs=[0])
    controller = make_controller(
        plant, [sp.Symbol("xi", real=True)], sp.zeros(1), sp.zeros(1), sp.eye(1)
    )
    form = Form(Network(1, (), quadratic=True), Network(1, (), quadratic=True))
    design = make_design(
        plant, (0, 0, 0, 0), form, [0, 0, 1.0, 0, 0, 0, 1.0, 0], [0.0],
        loop=interconnect(plant, controller),
    )  # fmt: skip
    certificate = local(design)
    assert holds(certificate)["equilibrium"]
    assert not holds(certificate)["attraction"]
    assert certificate.stability is None
    assert not certificate.certified
