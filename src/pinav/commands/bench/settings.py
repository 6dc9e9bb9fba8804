"""Options of `pinav bench`."""

import tyro

from pinav.commands.settings import Settings


class BenchOptions(Settings, frozen=True, forbid_unknown_fields=True):
    """Run a benchmark of a source checkout and print its table.

    Attributes:
        name: Name of the benchmark: accelerator, choice, fields, fit, gradient, growth,
            heat, navigate, recordings, roofline, start or trainer. What follows it are
            options of its own: pinav bench fit --help.
    """

    name: tyro.conf.Positional[str]
    words: tyro.conf.Suppress[tuple[str, ...]] = ()
