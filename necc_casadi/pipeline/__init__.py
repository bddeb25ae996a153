"""One run of necc-design."""
