"""Benchmarks, one module or package each, run by `python -m benchmarks NAME`."""
