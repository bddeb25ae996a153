"""Balls, tapes, and V in them."""
