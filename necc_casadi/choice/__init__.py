"""Which of several designs is kept."""
