"""The solver of bioheat beside exact solutions: `python -m validation.heat`."""
