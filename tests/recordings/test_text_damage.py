"""Tables of text, of every make: the same damage is refused, with its place."""

import gzip
from typing import NamedTuple

import pytest
from tests.defects import told
from tests.recordings.synthetic import EXAMPLE, rows_of


class Sample(NamedTuple):
    """A sound file of a format, in parts."""

    format: str
    header: list[str]
    columns: dict[str, str]  # name, frame, x, y
    reading: dict = {}
    above: list[str] = []
    below: list[list[str]] = []
    delimiter: str = ","
    blank: str = ""

    def lines(self):
        """The cells of the header, of what is below it, and of the rows."""
        rows = [self.row(self.header, *row) for row in ROWS]
        return [list(self.header), *map(list, self.below), *rows]

    def row(self, header, name, frame, x, y):
        known = {"name": name, "frame": str(frame), "x": str(x), "y": str(y)}
        roles = {column: known[role] for role, column in self.columns.items()}
        if self.format == "tidy":
            roles["t_s"] = str(frame / 10)
        return [roles.get(column, self.blank) for column in header]

    def text(self, lines):
        """The file."""
        joined = [self.delimiter.join(cells) for cells in lines]
        return "\n".join([*self.above, *joined, ""])

    def line(self, row):
        """Number of the line of a row, 0 first."""
        return len(self.above) + 2 + len(self.below) + row

    def fill(self, message):
        """A message with places and names of this sample."""
        lines, header = [self.line(row) for row in range(4)], len(self.above) + 1
        known = {"lines": lines, "header": header, "first": self.header[0]}
        return message.format(cells=len(self.header), **known, **self.columns)

    def edited(self, row, role, value):
        """The file with one cell changed."""
        lines = self.lines()
        lines[row + 1 + len(self.below)][self.header.index(self.columns[role])] = value
        return self.text(lines)

    def without(self, role):
        """The file with one column less."""
        index = self.header.index(self.columns[role])
        return self.text([c[:index] + c[index + 1 :] for c in self.lines()])

    def lost(self):
        """The cells, every position a NaN."""
        lines = self.lines()
        for cells in lines[1 + len(self.below) :]:
            for role in "xy":
                cells[self.header.index(self.columns[role])] = "nan"
        return lines


ROWS = list(rows_of(EXAMPLE[:1]))
ROLES = ("name", "frame", "x", "y")


def roles(*columns):
    return dict(zip(ROLES, columns, strict=True))


TRACKMATE = Sample(
    "trackmate-csv",
    ["LABEL", "TRACK_ID", "POSITION_X", "POSITION_Y", "FRAME"],
    roles("TRACK_ID", "FRAME", "POSITION_X", "POSITION_Y"),
)
LONG = ["Label", "Track ID", "X", "Y", "Frame"]
MAP = {"frame": "Zeit", "particle": "Bot", "x": "lage x", "y": "lage y"}
SAMPLES = {
    "tidy": Sample(
        "tidy",
        ["particle", "frame", "t_s", "x_px", "y_px"],
        roles("particle", "frame", "x_px", "y_px"),
    ),
    "trackpy": Sample(
        "trackpy",
        ["x", "y", "mass", "frame", "particle"],
        roles("particle", "frame", "x", "y"),
    ),
    "TrackMate, raw": TRACKMATE._replace(
        below=[LONG, LONG, ["", "", "(pixel)", "(pixel)", ""]]
    ),
    "TrackMate, re-saved": TRACKMATE,
    "SFI": Sample(
        "sfi",
        ["particle_id", "frame", "x", "y"],
        roles("particle_id", "frame", "x", "y"),
        above=["# dt: 0.01", "# description: a trap"],
    ),
    "ImageJ, manual tracking": Sample(
        "imagej",
        ["Track n°", "Slice n°", "X", "Y", "Distance"],
        roles("Track n°", "Slice n°", "X", "Y"),
        delimiter="\t",
        blank="-1",
    ),
    "any table": Sample(
        "table",
        ["Zeit", "Bot", "lage x", "lage y"],
        roles("Bot", "Zeit", "lage x", "lage y"),
        reading={"columns": MAP},
        delimiter=";",
    ),
}
NUMBER = "expected a finite number, got"


def cell(row, role, value, message=None):
    """One cell is another, and its place stands before the message."""
    place = f"line {{lines[{row}]}}, column '{{{role}}}': "
    message = message or f"{NUMBER} {value!r}"
    return lambda s: s.edited(row, role, value), place + message


HEADER_ALONE = r"(line \d+: the header is all there is|no spot belongs)"
UNENDED = r"line \d+: (not CSV: unexpected end of data|expected)"
CELLS = r"expected {cells} cells, as in the header"
DAMAGE = {
    "empty": (lambda s: "", "the file is empty"),
    "header alone": (lambda s: s.text(s.lines()[: 1 + len(s.below)]), HEADER_ALONE),
    "x missing": (lambda s: s.without("x"), "header: .*'{x}'( or 'XM')? is missing"),
    "y missing": (lambda s: s.without("y"), "header: .*'{y}'( or 'YM')? is missing"),
    "column twice": (
        lambda s: s.text(
            [c + c[-1:] if i else [*c, c[0]] for i, c in enumerate(s.lines())]
        ),
        "line {header}: column '{first}' stands twice",
    ),
    "decimal comma": (
        lambda s: s.edited(0, "x", '"1,5"'),
        "line {lines[0]}, .*got '1,5'; write decimals with a point",
    ),
    "frame twice": (
        lambda s: s.edited(1, "frame", "2"),
        "line {lines[2]}, column .*: frame 2 of '0' stands in line {lines[1]} already; "
        "delete one",
    ),
    "row cut short": (
        lambda s: s.text([*s.lines()[:-1], s.lines()[-1][:-1]]),
        "line {lines[3]}: " + CELLS,
    ),
    "row too long": (
        lambda s: s.text([*s.lines()[:-1], [*s.lines()[-1], "7"]]),
        "line {lines[3]}: " + CELLS,
    ),
    "other delimiter": (
        lambda s: s.text(s.lines()).replace(s.delimiter, "|"),
        r"(header|line \d+): .*",
    ),
    "open quote": (lambda s: s.edited(3, "x", '"1'), UNENDED),
    "bytes that are no text": (
        lambda s: s.edited(1, "x", "\udcff"),
        "line {lines[1]}: expected UTF-8 text, got the byte 0xff",
    ),
    "zeros in the text": (
        lambda s: s.edited(1, "x", "1\0"),
        "line {lines[1]}: expected text, got binary data",
    ),
    "gzip cut short": (
        lambda s: gzip.compress(s.text(s.lines()).encode())[:-10],
        "damaged gzip file: .* copy it from its origin again",
    ),
    "single row": (
        lambda s: s.text(s.lines()[: 2 + len(s.below)]),
        "the longest of 1 segments has a single position",
    ),
    "no positions": (
        lambda s: s.text(s.lost()),
        "the longest of 0 segments has a single position",
    ),
    "word in x": cell(1, "x", "wall"),
    "word in y": cell(2, "y", "low"),
    "word in frame": cell(3, "frame", "four"),
    "infinite x": cell(0, "x", "inf"),
    "digits with underscores": cell(0, "x", "1_0"),
    "no frame": cell(1, "frame", "", ".* empty cell"),
    "NaN frame": cell(1, "frame", "nan"),
    "negative frame": cell(1, "frame", "-1", ".* whole number >= 0, got -1"),
    "half a frame": cell(1, "frame", "1.5", ".* whole number >= 0, got 1.5"),
    "no particle": cell(1, "name", "", ".* an empty cell"),
}
FINE = {("TrackMate, raw", "no particle"), ("TrackMate, re-saved", "no particle")}
CASES = [(s, d) for s in SAMPLES for d in DAMAGE if (s, d) not in FINE]


@pytest.mark.parametrize(("name", "damage"), CASES)
def test_damage_is_named_with_its_place(read, name, damage):
    sample = SAMPLES[name]
    damaged, message = DAMAGE[damage]
    content = damaged(sample)
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogateescape")
    reading = {"format": sample.format, **sample.reading}
    with told(rf"a\.csv: .*{sample.fill(message)}"):
        read(content, name="a.csv", **reading)


@pytest.mark.parametrize("name", SAMPLES)
def test_the_sample_itself_is_sound(read, name):
    """So that each refusal is for its damage alone."""
    sample = SAMPLES[name]
    text = sample.text(sample.lines())
    assert len(read(text, format=sample.format, **sample.reading)) == 1
    assert len(read(text, **sample.reading)) == 1  # the format is found, too
