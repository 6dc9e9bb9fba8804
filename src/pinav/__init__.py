"""pinav: learn the unknown force on a driven microswimmer from its trajectories."""

__version__ = "0.1.0"
