"""Certificates altered, and what the checker says of them."""

import json

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims import statements


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
    attraction["statement"] = statements.attraction(attraction["data"]["rate"])
    region = claim(data, "region")
    follows = region["data"]["follows"]
    size = (data["level"], data["domain_share"], data["limited_by"])
    region["statement"] = statements.region(*size, follows)


def claim(data, name):
    return next(c for c in data["claims"] if c["name"] == name)
