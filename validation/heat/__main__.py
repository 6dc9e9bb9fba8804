"""Print the errors of the solver on this machine; exit with 1 if one is too large."""

import sys

import jax
from validation.heat.checks import table
from validation.heat.verification import verify

from pinav.report import as_text

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", val=True)
    checks = verify()
    print(as_text(table(checks)))
    if missed := [check.case for check in checks if not check.within]:
        sys.exit(f"outside their tolerance: {', '.join(missed)}")
