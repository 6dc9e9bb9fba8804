"""Small tracks for the tests of importers, and what reading them must give back."""

import io
from typing import NamedTuple

import numpy as np
import openpyxl
from hypothesis import strategies as st

from pinav.recordings import labels

POSITIONS = st.floats(0, 8)  # no two of them a jump apart


class Track(NamedTuple):
    """One particle as its file has it: y down, in pixels."""

    name: str
    frames: list[int]
    xs: list[float]
    ys: list[float]


@st.composite
def tracks(draw, names=("0", "1", "2"), first_frame=0):
    """Up to three particles, with frames lost here and there."""
    found = []
    for name in names[: draw(st.integers(1, len(names)))]:
        steps = draw(st.lists(st.integers(1, 3), min_size=1, max_size=4))
        frames = np.cumsum([draw(st.integers(first_frame, 5)), *steps]).tolist()
        xs = draw(st.lists(POSITIONS, min_size=len(frames), max_size=len(frames)))
        ys = draw(st.lists(POSITIONS, min_size=len(frames), max_size=len(frames)))
        found.append(Track(name, frames, xs, ys))
    return found


EXAMPLE = [
    Track("0", [0, 1, 2, 4], [1.0, 2.0, 3.0, 5.0], [0.0, 0.5, 1.0, 1.5]),
    Track("1", [1, 2, 3], [10.0, 11.0, 12.0], [3.0, 2.0, 1.0]),
]


def check(data, truth, *, mpp=1.0, fps=1.0, up=False):
    """Every digit of every track came back, in the conventions of pinav."""
    assert [label["particle"] for label in labels(data)] == [t.name for t in truth]
    for piece, track in zip(data, truth, strict=True):
        np.testing.assert_array_equal(piece.times, np.array(track.frames) / fps)
        sign = 1 if up else -1
        expected = np.stack([track.xs, sign * np.array(track.ys)], axis=1)
        np.testing.assert_array_equal(piece.states, mpp * expected)
        assert piece.observed.all()


def rows_of(truth):
    """(name, frame, x, y) of each row, the particles one after the other."""
    for track in truth:
        for row in zip(track.frames, track.xs, track.ys, strict=True):
            yield (track.name, *row)


def packed(write, *args, **named):
    """The bytes that a function writes into the file that is its first argument."""
    file = io.BytesIO()
    write(file, *args, **named)
    return file.getvalue()


def npy(values):
    return packed(np.save, values)


def workbook(content):
    """A workbook with these rows in its sheets."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in content.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    return packed(book.save)
