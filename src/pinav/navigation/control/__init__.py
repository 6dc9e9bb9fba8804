"""Controllers and what they need: predictions, costs, delay compensation."""
