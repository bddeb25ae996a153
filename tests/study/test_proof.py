"""Sampled plants beside the proof: the right plants, in the proved band, and other plants."""

import json
from dataclasses import replace

import numpy as np
import pytest

from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.designs.design import Design
from necc_casadi.designs.plant_file import read_plant
from necc_casadi.errors import OptionError
from necc_casadi.performance.beside_proof import BesideProof, Proved, beside_proof, proved
from necc_casadi.report.beside import proved_and_sampled, shown_states
from necc_casadi.report.proof_figure import proof_figure
from necc_casadi.simulation.responses import simulate
from necc_casadi.study.montecarlo import MonteCarlo
from necc_casadi.study.proof import subject
from necc_casadi.study.tables import Table


def finished(about, rows):
    study = MonteCarlo(about.design.text, about.plant, about.bands, 1, 0)
    texts = [
        [str(k), *("" if v is None else str(v).lower() for v in study.row(k))] for k in range(rows)
    ]
    return Table(study.columns, texts)


def test_plants_of_the_proof_rest_in_its_band(ranged):
    about = subject(ranged, None)
    assert {band.name for band in about.bands} == {"m", "d_u"}
    assert about.is_covered
    table = finished(about, 6)
    beside = about.beside(table, 0)
    lo, hi = about.proved.error["q"]
    rests = beside.at_rest[:, 0]
    assert np.all((lo < rests) & (rests < hi))
    assert hi - lo < 3 * (rests.max() - rests.min())  # and that is about what it takes
    for error, rest in zip(beside.errors, rests, strict=True):
        assert error[-1, 0] == pytest.approx(rest, abs=1e-5)
    (row,) = about.rows(beside)
    assert "q proved" in row
    assert "/ sampled" in row
    assert about.in_json(beside)["sampled_error"]["q"][0] == rests.min()


def test_a_disturbance_is_one_of_the_simulation_of_designs(ranged):
    """By the other integrator, with d on top of u."""
    made = Design.load(ranged)
    plant, _ = read_plant(ranged, made)
    found = Proved("family", {"d_u": (0.05, 0.1)}, {"q": (-1.0, 1.0), "p_q": (-1.0, 1.0)})
    beside = beside_proof(made, found, plant)
    (corner, *_), end = beside.errors, beside.times[-1]
    q = made.z_star[0] + corner[0, 0]
    response = simulate(made, [q, corner[0, 1]], disturbance=[0.05], time=end)
    assert corner[-1, 0] == pytest.approx(response.z[-1, 0] - made.z_star[0], abs=1e-6)
    assert len(beside.errors) == 40


def test_a_proof_of_other_plants_is_not_set_beside_them(ranged):
    about = subject(ranged, "m=30%")
    assert not about.is_covered
    assert about.beside(finished(about, 1), 0) is None
    assert about.in_json(None) is None
    assert "not about all of these plants" in about.rows(None)[0]
    assert subject(ranged, "m=5%").is_covered
    assert not subject(ranged, "d_u=-0.2:0.1").is_covered


def test_without_a_proof_bands_have_to_be_named(weighed):
    with pytest.raises(OptionError, match="--vary is missing"):
        subject(weighed[1], None)
    assert subject(weighed[1], "m=10%").proved is None


def test_what_the_run_itself_shows(ranged):
    """The figure is in the folder and on the page."""
    assert (ranged / "figures" / "proof.png").read_bytes().startswith(b"\x89PNG")
    page = (ranged / "report.html").read_text(encoding="utf-8")
    assert "Simulated beside proved." in page
    assert "/ sampled" in page


def test_what_words_and_figure_say():
    sides = {"q": (-0.125, 0.25), "p": (0.0, 0.0)}
    times = np.linspace(0, 1, 5)
    error = np.stack([np.linspace(1, 0.15, 5), np.linspace(1, 0, 5)], axis=1)
    rests = (np.array([0.15, 0.0]), None)
    found = BesideProof(Proved("family", {"m": (1, 2)}, sides), times, (error, error), rests)
    states = ("q", "p")
    assert shown_states(found, states) == [0]
    text = proved_and_sampled(found, states, {"q": "rad"})
    words = "q proved -0.125 … 0.25 / sampled 0.15 … 0.15 rad, 2 plants"
    assert text == f"{words}; 1 of 2 plants do not rest nearby"
    assert len(proof_figure(found, "name", states, {}).axes) == 2
    nothing = replace(found, proved=replace(found.proved, error=dict.fromkeys(states, (0.0, 0.0))))
    assert proof_figure(nothing, "name", states, {}) is None
    exact = replace(nothing, proved=replace(nothing.proved, claim="integral"))
    assert "error at rest proved 0 / sampled at most 0.15" in proved_and_sampled(exact, states, {})
    assert proof_figure(exact, "name", states, {}) is not None


def test_the_certificate_of_one_plant_proves_nothing_of_others(ranged):
    made = Design.load(ranged)
    text = (ranged / "certificate.json").read_text(encoding="utf-8")
    certificate = Certificate.from_json(text)
    assert proved(made, certificate) is None  # without its family.json
    assert proved(made, None) is None
    names = [c["name"] for c in json.loads(text)["claims"]]
    assert "family" in names
