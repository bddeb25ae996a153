"""The finished design: a value, saved and loaded bit for bit."""
