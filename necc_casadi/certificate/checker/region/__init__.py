"""Regions, re-proved."""
