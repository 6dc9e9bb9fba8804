"""Models of the surroundings that planning and control evaluate."""
