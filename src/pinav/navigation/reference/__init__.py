"""Independent references: optimal paths and a Gaussian process."""
