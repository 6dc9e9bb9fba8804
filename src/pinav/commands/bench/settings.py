"""Options of `pinav bench`."""

import tyro

from pinav.commands.settings import Settings


class BenchOptions(Settings, frozen=True, forbid_unknown_fields=True):
    """Run a benchmark of a source checkout and print its table.

<<<<<<< HEAD
    name: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            help="Name of the benchmark: fit, gradient, growth, heat, navigate, "
            "recordings or trainer. What follows it are options of its own: pinav "
            "bench fit --help."
        ),
    ]
=======
    Attributes:
        name: Name of the benchmark: fit, gradient, growth, heat, navigate or
            recordings. What follows it are options of its own: pinav bench fit --help.
    """

    name: tyro.conf.Positional[str]
>>>>>>> main
    words: tyro.conf.Suppress[tuple[str, ...]] = ()
