"""Bioheat: Pennes' equation with magnetic heating, its gradients and its dose.

Import from the modules: `bioheat` has the equation, `solve` runs a protocol, `learning`
fits perfusion to probes and `optimise` protocols to limits. `setup` reads a case from a
TOML file; `heated_run`, `learned_tissue` and `planned_run` answer what it asks.

Research code on synthetic data; nothing here is medical advice.
"""
