"""Dependence of a fit and its rollouts on data and parameters."""
