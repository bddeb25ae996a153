"""Exact answers about expressions; knows no plant."""
