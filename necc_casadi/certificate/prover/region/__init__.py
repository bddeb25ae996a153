"""Regions of attraction."""
