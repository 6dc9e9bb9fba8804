"""Strict JAX, strict types: set before pinav is imported by any test."""

import os

os.environ.setdefault("MPLBACKEND", "Agg")

import jax
import jaxtyping

jax.config.update("jax_enable_x64", val=True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

jaxtyping.install_import_hook("pinav", "beartype.beartype")
