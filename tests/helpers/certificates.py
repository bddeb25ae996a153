"""Certificates altered, and what the checker says of them."""

import json
from dataclasses import replace

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims import statements
from necc_casadi.certificate.claims.claim import Claim
from necc_casadi.certificate.claims.regions import Obstacle
from necc_casadi.certificate.prover.certify import certify


def written(design, folder):
    """A folder with a design and its certificate."""
    folder.mkdir(exist_ok=True)
    design.save(folder / "design.json")
    (folder / "certificate.json").write_text(certify(design).to_json(), encoding="utf-8")
    return folder


def of_small_level(design):
    """A claim about set-points of a level 1, below the one that is proved of the pendulum."""
    plain = certify(replace(design, setpoints={}, told=None), region=False)
    data = {"level": 1.0, "half_widths": [2.0, 2.0], "mu": 0.1, "away": 1e-9}
    held = Claim("setpoints", True, "less than is proved", data)
    return replace(plain, design_hash=design.hash, claims=(*plain.claims, held))


def verdicts(folder) -> dict[str, bool]:
    return {result.name: result.holds for result in check(folder)}


def altered(folder, tmp_path, change) -> dict[str, bool]:
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    change(data)
    reword(data)
    (tmp_path / "certificate.json").write_text(json.dumps(data), encoding="utf-8")
    (tmp_path / "design.json").write_bytes((folder / "design.json").read_bytes())
    return verdicts(tmp_path)


def reword(data):
    """Let the statements say what the altered numbers say: only a proof can tell them apart."""
    numbers = (data["radius"], data["mu"], data["bound_rigorous"])
    claim(data, "equilibrium")["statement"] = statements.equilibrium(*numbers)
    attraction = claim(data, "attraction")
    attraction["statement"] = statements.attraction(attraction["data"].get("rate"))
    if data["region"] is not None:
        region = claim(data, "region")
        region["statement"] = worded(data, region["data"]["follows"])


def worded(data, follows) -> str:
    """What a certificate's numbers say of its region."""
    obstacle = Obstacle(**data["obstacle"])
    return statements.region(data["level_above_minimum"], obstacle, follows)


def claim(data, name):
    return next(c for c in data["claims"] if c["name"] == name)


def checked_family(folder, design, family, certificate):
    """What the checker says of these texts of a design and its family, by claim."""
    for name, text in (("design", design), ("family", family)):
        (folder / f"{name}.json").write_text(text, encoding="utf-8")
    (folder / "certificate.json").write_text(json.dumps(certificate), encoding="utf-8")
    return {result.name: result for result in check(folder)}
