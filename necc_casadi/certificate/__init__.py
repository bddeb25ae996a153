"""Certificates: what is proved about a finished design, and nothing else."""

from necc_casadi.certificate.claim import Claim
from necc_casadi.certificate.proof import Certificate, certify

__all__ = ["Certificate", "Claim", "certify"]
