"""Evidence of linearised observations under Gaussian priors."""
