"""The Lyapunov function V = Φ(H + Hc, C) and its derivatives (eq. casimir_parameterization)."""
