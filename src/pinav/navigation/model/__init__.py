"""Models of the time_cost that planning and control evaluate."""
