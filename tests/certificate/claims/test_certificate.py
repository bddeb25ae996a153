"""certificate.json: what is written is read again, and nothing else is."""

import json

import pytest
from helpers.constructed import (
    quadratic_pendulum,
)

from necc_casadi.certificate.checker.check import check
from necc_casadi.certificate.claims.certificate import Certificate
from necc_casadi.certificate.claims.claim import CERTIFICATE_FORMAT
from necc_casadi.certificate.prover.certify import certify
from necc_casadi.cli.certify import _certify
from necc_casadi.cli.terminal import run
from necc_casadi.errors import OutputError


def local(design) -> Certificate:
    return certify(design, region=False)


def test_certificate_file_round_trip_and_damage():
    certificate = local(quadratic_pendulum())
    assert Certificate.from_json(certificate.to_json()) == certificate
    for text in ("", "{}", "[]", certificate.to_json().replace('"format": 5', '"format": 99')):
        with pytest.raises(OutputError):
            Certificate.from_json(text)


def test_a_certificate_of_an_older_format_is_to_be_made_again(tmp_path, capsys):
    design = quadratic_pendulum()
    design.save(tmp_path / "design.json")
    data = json.loads(local(design).to_json())
    assert data["format"] == CERTIFICATE_FORMAT == 5
    older = json.dumps(data | {"format": 2})
    (tmp_path / "certificate.json").write_text(older, encoding="utf-8")
    for read in (lambda: Certificate.from_json(older), lambda: check(tmp_path)):
        with pytest.raises(OutputError) as refusal:
            read()
        assert refusal.value.fault == "certificate.json has format 2"
        assert refusal.value.remedy == "Run necc-design again; this version reads format 5."
    assert run(_certify, [str(tmp_path)]) == 2
    assert "Run necc-design again" in capsys.readouterr().err
