"""From a verdict to a design: training, shaping and damping (eq. Loss)."""
