"""Benchmarks, one module or package each, run by `pinav bench NAME`."""
