"""TrackMate: spots as CSV with four header rows or one, and tracks as XML."""

import numpy as np
import pytest
from hypothesis import given, settings
from tests.defects import defects, told
from tests.recordings.synthetic import EXAMPLE, Track, check, rows_of, tracks

from pinav.recordings import Reading, labels, read_recording

NAMES = "LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME"
LONG = "Label,Spot ID,Track ID,X,Y,Z,T,Frame"
UNITS = ",,,({0}),({0}),({0}),({1}),"


def spots(truth, *, raw=True, interval=0.05, space="pixel", time="sec"):
    """A file of spots, not in order."""
    head = [NAMES, LONG, LONG, UNITS.format(space, time)] if raw else [NAMES]
    rows = [
        f"ID{f},{f},{name},{x!r},{y!r},0.0,{f * interval!r},{f}"
        for name, f, x, y in rows_of(truth)
    ]
    return "\n".join([*head, rows[0], *rows[:0:-1]]) + "\n"


@pytest.mark.parametrize("raw", [True, False])
@settings(max_examples=20)
@given(truth=tracks())
def test_spots_come_back_whole(tmp_path_factory, raw, truth):
    path = tmp_path_factory.mktemp("trackmate") / "spots.csv"
    path.write_text(spots(truth, raw=raw))
    by_name = sorted(truth, key=lambda track: track.name)
    data = read_recording(path, Reading(fps=20.0, mpp=0.656))
    order = np.argsort([label["particle"] for label in labels(data)])
    check(data.select(order), by_name, mpp=0.656, fps=20.0)


def test_units_of_the_raw_file_are_taken(read):
    data = read(spots(EXAMPLE, space="micron", time="msec", interval=50.0))
    assert data.units == {"x": "um", "y": "um", "t": "s"}
    np.testing.assert_allclose(data.trajectory(0).times, [0, 0.05, 0.1, 0.2])
    with told("mpp: positions are in um already"):
        read(spots(EXAMPLE, space="micron"), mpp=0.5)
    metres = read(spots(EXAMPLE, space="mm"), jump=1e6)
    np.testing.assert_allclose(metres.states[0, 0, 0], 1000)


def test_frame_numbers_said_to_be_seconds_are_noticed(read):
    """The traps of a film that was never calibrated."""
    data = read(spots(EXAMPLE, interval=1.0))
    assert data.units["t"] == "frame"
    note = "times equal the frame numbers, although they are said to be in sec"
    assert note in data.provenance["notes"][0]
    corrected = read(spots(EXAMPLE, interval=1.0), fps=20.0)
    assert corrected.units["t"] == "s"
    np.testing.assert_array_equal(corrected.trajectory(0).times, [0, 0.05, 0.1, 0.2])


def test_spots_without_a_track_are_left_out_and_counted(read):
    text = spots(EXAMPLE) + "ID9,9,,1.0,2.0,0.0,0.1,2\nID8,8,None,1.0,2.0,0,0.1,3\n"
    data = read(text)
    assert len(data) == 2
    assert "2 spots without a track left out" in data.provenance["notes"]
    with told(r"line 5, .*no spot belongs to a track"):
        read(spots([EXAMPLE[0]._replace(name="None")]))


RAW = spots(EXAMPLE)
ROW_OF_UNITS = UNITS.format("pixel", "sec")
BAD_HEADERS = [
    (
        RAW.replace(ROW_OF_UNITS + "\n", ""),
        r"line 4: expected the row of units, such as \(pixel\) .* got 'ID0'; a raw fi",
    ),
    (
        "\n".join([NAMES, LONG, ROW_OF_UNITS, *RAW.split("\n")[4:]]),
        r"line 4: expected the row of units",
    ),
    ("\n".join(RAW.split("\n")[:4]), r"line \d: .*|no spot"),
]


@defects("text, message", BAD_HEADERS)
def test_damaged_header_is_named(read, text, message):
    with told(message):
        read(text)


XML = '<Tracks spaceUnits="{}" timeUnits="{}" frameInterval="{}">\n{}\n</Tracks>'


def xml(truth, *, space="pixel", time="sec", interval="0.05"):
    particles = []
    for track in truth:
        rows = rows_of([track])
        inner = "\n".join(
            f'<detection t="{f}" x="{x!r}" y="{y!r}" z="0.0" />' for _, f, x, y in rows
        )
        particles.append(
            f'<particle nSpots="{len(track.frames)}">\n{inner}\n</particle>'
        )
    return XML.format(space, time, interval, "\n".join(particles))


@settings(max_examples=20)
@given(truth=tracks())
def test_xml_comes_back_whole(tmp_path_factory, truth):
    path = tmp_path_factory.mktemp("trackmate") / "tracks.xml"
    path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n' + xml(truth))
    check(
        read_recording(path, Reading(fps=20.0, mpp=0.656)), truth, mpp=0.656, fps=20.0
    )
    own = read_recording(path)
    assert own.units == {"x": "px", "y": "px", "t": "s"}
    frames = np.array(truth[0].frames)
    np.testing.assert_array_equal(own.trajectory(0).times, 0.05 * frames)


def test_xml_of_a_film_never_calibrated(read):
    for interval, time in (("1.0", "sec"), ("1.0", "frame")):
        data = read(xml(EXAMPLE, interval=interval, time=time), name="a.xml")
        assert data.units["t"] == "frame"
    micron = read(xml(EXAMPLE, space="µm", time="ms"), name="a.xml")
    assert micron.units == {"x": "um", "y": "um", "t": "s"}
    np.testing.assert_allclose(micron.trajectory(0).times[1], 5e-5)


DECLARED = '<?xml version="1.0" encoding="UTF-8"?>'
GOOD = xml(EXAMPLE)
SPOT = "particle 1, detection 2, column"
SPACED = XML.format("px", "s", 1, "{}")
LONE = [t._replace(frames=t.frames[:1], xs=t.xs[:1], ys=t.ys[:1]) for t in EXAMPLE]
AT = 't="1" x="2'
BAD_XML = [
    (GOOD[:-30], r"line \d+, column \d+: not well-formed XML"),
    (GOOD.replace("</particle>", "", 1), r"line \d+, column \d+: not"),
    ("<Other><Model/></Other>", r"<Other>: expected <Tracks>"),
    (SPACED.format(""), r"<Tracks>: no <particle> in it"),
    (SPACED.format("<particle></particle>"), r"<particle>: no <detection>; export"),
    (
        GOOD.replace('nSpots="4"', 'nSpots="9"'),
        r"particle 1, attribute 'nSpots': expected 9 detections, got 4; export",
    ),
    (GOOD.replace(' x="2.0"', ""), rf"{SPOT} 'x': .* got an empty cell"),
    (GOOD.replace(AT, 'x="2'), rf"{SPOT} 't': .* got an empty cell"),
    (GOOD.replace('x="2.0"', 'x="wall"'), rf"{SPOT} 'x': .* got 'wall'"),
    (GOOD.replace('x="2.0"', 'x="2_0"'), rf"{SPOT} 'x': .* got '2_0'"),
    (GOOD.replace('x="2.0"', 'x="NaN"'), rf"{SPOT} 'x': .* got 'NaN'"),
    (GOOD.replace('y="0.5"', 'y="inf"'), rf"{SPOT} 'y': .* got 'inf'"),
    (GOOD.replace(AT, 't="1.5" x="2'), rf"{SPOT} 't': .* whole number >= 0, got 1.5"),
    (GOOD.replace(AT, 't="-1" x="2'), rf"{SPOT} 't': .* got -1"),
    (
        GOOD.replace(AT, 't="2" x="2'),
        r"particle 1, detection 3, column 't': frame 2 of '0' stands in particle 1, de",
    ),
    (xml(EXAMPLE, interval="fast"), r"'frameInterval': .* got 'fast'"),
    (xml(EXAMPLE, interval="0"), r"'frameInterval': expected a number > 0, got"),
    (xml(LONE), r"the longest of 2 segments has a single position"),
    (
        f'<!DOCTYPE t [<!ENTITY a "1"><!ENTITY b "&a;&a;">]>{GOOD}',
        r"declares entities or a document type, which is not read",
    ),
    (
        f'<!DOCTYPE t [<!ENTITY a SYSTEM "file:///etc/hostname">]>{GOOD}',
        r"declares entities or a document type",
    ),
    (
        f"{DECLARED}{GOOD}".encode().replace(b"sec", b"\xb5"),
        r"line 1, column \d+: not well-formed XML",
    ),
]


@defects("content, message", BAD_XML)
def test_damaged_xml_is_named_with_its_place(read, content, message):
    with told(rf"a\.xml: .*{message}"):
        read(content, name="a.xml")


def test_a_bad_spot_is_left_out_and_counted(read):
    line = [Track("0", list(range(20)), np.arange(20.0).tolist(), [0.0] * 20)]
    text = xml(line).replace('x="7.0"', 'x="wall"')
    data = read(text, name="a.xml", strict=False)
    assert data.lengths.tolist() == [19]
    (fault,) = data.provenance["bad rows left out"]
    assert "particle 1, detection 8, column 'x'" in fault
