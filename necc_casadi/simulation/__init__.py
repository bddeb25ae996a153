"""Responses of a finished design."""
