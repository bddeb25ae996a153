"""Many plants, many designs: studies that can be stopped and go on."""
