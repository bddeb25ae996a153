"""Target structures: the same plant, written with another energy."""
