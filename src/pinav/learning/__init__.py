"""Learning: the choice of model and recipe, and the result of a fit as a value."""
