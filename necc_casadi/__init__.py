"""Neural energy-Casimir control for port-Hamiltonian systems."""

__version__ = "0.1.0"
