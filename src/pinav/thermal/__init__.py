"""Bioheat: Pennes' equation with magnetic heating, its gradients and its dose.

Research code on synthetic data; nothing here is medical advice.
"""
