"""Intervals, jets, and V over boxes."""
