"""A cluster whose worker is this process, with what it has compiled and patched."""

import contextlib

from pinav.sweeps import Cluster
from pinav.sweeps.attempt import attempt


class Answered:
    """A future that has its answer."""

    status = "finished"

    def __init__(self, answer):
        self.answer = answer

    def result(self):
        return self.answer


class Client:
    """What a sweep asks of the client of Dask."""

    status = "running"

    def scheduler_info(self, **_):
        return {"workers": {"here": {}}}

    def submit(self, function, version, order, **_):
        return Answered(attempt(version, order))


def here(client=None):
    """The cluster of a client, as `map_cells` opens one."""
    return contextlib.nullcontext(Cluster(client or Client(), "this process"))
