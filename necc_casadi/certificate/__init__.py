"""Certificates: what is proved about a finished design, and nothing else."""

from necc_casadi.certificate.certify import Certificate, certify
from necc_casadi.certificate.claim import Claim

__all__ = ["Certificate", "Claim", "certify"]
