"""Trajectories from tables of other packages, and as tables for them."""

import equinox as eqx
import numpy as np
import pandas
import pytest

from pinav.errors import InputError
from pinav.trajectories import Trajectories

COLUMNS = {
    "trajectory": [7, 7, 7, 3, 3],
    "t": [0.0, 0.1, 0.3, 0.0, 0.2],
    "x": [1.0, np.nan, 3.0, 4.0, 5.0],
    "y": [0.0, 1.0, 2.0, 3.0, np.nan],
    "f": [5.0, 5.0, 6.0, 6.0, 6.0],
}


class Stream:
    """Any object with the Arrow stream protocol and nothing else."""

    def __init__(self, table):
        self.table = table

    def __arrow_c_stream__(self, requested_schema=None):
        return self.table.__arrow_c_stream__(requested_schema)


def pandas_table():
    return pandas.DataFrame(COLUMNS)


def arrow_table():
    return pytest.importorskip("pyarrow").Table.from_pandas(pandas_table())


TABLES = {
    "columns": lambda: COLUMNS,
    "pandas": pandas_table,
    "pandas with NA": lambda: pandas_table().convert_dtypes(),
    "pyarrow": arrow_table,
    "Arrow stream": lambda: Stream(arrow_table()),
}


@pytest.mark.parametrize("make", TABLES.values(), ids=TABLES)
def test_a_table_becomes_trajectories(make):
    units = {"x": "um", "t": "s"}
    data = Trajectories.from_table(make(), commands=["f"], units=units)
    assert data.channels == ("x", "y")
    assert data.units == {"x": "um", "y": "?", "t": "s", "f": "?"}
    np.testing.assert_array_equal(data.lengths, [3, 2])
    first, second = data
    np.testing.assert_array_equal(first.states, [[1, 0], [0, 1], [3, 2]])
    np.testing.assert_array_equal(first.observed, [[1, 1], [0, 1], [1, 1]])
    np.testing.assert_array_equal(second.times, [0.0, 0.2])
    np.testing.assert_array_equal(second.commands["f"], [6, 6])


@pytest.mark.parametrize(
    "through", [dict, pandas.DataFrame, "pyarrow"], ids=["dict", "pandas", "pyarrow"]
)
def test_a_table_and_back_is_the_same(through):
    if through == "pyarrow":
        through = pytest.importorskip("pyarrow").table
    data = Trajectories.from_table(COLUMNS, commands=["f"], units={"x": "um"})
    again = Trajectories.from_table(
        through(data.to_table()), commands=["f"], units=data.units
    )
    assert eqx.tree_equal(again, data)


def test_headings_state_units():
    data = Trajectories.from_table({"t [s]": [0, 1], "x (um)": [1, 2], "y": [0, 0]})
    assert data.channels == ("x", "y")
    assert data.units == {"t": "s", "x": "um", "y": "?"}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (3, "expected a table of pandas, polars or pyarrow, .* got a int"),
        ({"x": [1.0, 2.0]}, "column 't' is missing; got x"),
        ({"t": [0, 1], "x": ["a", "b"]}, "column 'x': expected numbers, got could not"),
        ({"t": [0, 0], "x": [1, 2]}, "time 0.0 after 0.0 is repeated"),
        ({"t": [0, 1]}, "channels: expected names"),
    ],
)
def test_what_is_no_table_is_refused(table, message):
    with pytest.raises(InputError, match=message):
        Trajectories.from_table(table)


def test_only_some_channels():
    data = Trajectories.from_table(COLUMNS, commands=["f"], units={"x": "um"})
    alone = data.only(["y"])
    assert alone.channels == ("y",)
    assert alone.units == {"y": "?", "t": "?", "f": "?"}
    np.testing.assert_array_equal(alone.states[..., 0], data.states[..., 1])
    assert (data.dim, alone.dim) == (2, 1)
    np.testing.assert_array_equal(data.positions, data.states)
    with pytest.raises(InputError, match="channel 'z': expected some of x, y"):
        data.only(["z"])
