"""Loops for targets that the published one cannot hold (docs/theory.md#methods)."""
