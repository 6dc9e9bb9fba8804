"""`pinav live` on the command line: a replay, a followed file, messages."""

import json
import math

import msgspec
import pytest
from tests.live.sessions import HELLO, frame_line

from pinav import cli
from pinav.commands.live import LiveSettings
from pinav.live.messages import encode

HEADER = "t_s,x_um,y_um,freq_hz,alpha_rad\n"


@pytest.fixture
def lines(tmp_path):
    path = tmp_path / "frames.jsonl"
    frames = [frame_line(n, x=0.1 * n, frequency=1.0) for n in range(8)]
    bye = b'{"type":"bye"}\n'
    path.write_bytes(encode(HELLO) + b"\n".join(frames) + b"\ngarbage\n" + bye)
    return path


def said(capsys):
    captured = capsys.readouterr()
    rows = [json.loads(line) for line in captured.out.splitlines()]
    return rows, captured.err


def test_a_followed_file_and_its_replay_say_the_same(lines, tmp_path, capsys, refused):
    out = ("--out", str(tmp_path / "run"))
    assert cli.run(["live", str(lines), *out]) == 0
    live, summary = said(capsys)
    assert "8 frames, 0 commands, identifying; a frame took" in summary
    assert cli.run(["live", str(lines), "--replay"]) == 0
    replayed, _ = said(capsys)
    for row in live:
        if row["type"] == "state":
            row["latency_ms"] = None
    assert [r for r in live if r["type"] != "event"] == [
        r for r in replayed if r["type"] != "event"
    ]
    assert {"refused", "bye"} <= {r["kind"] for r in live if r["type"] == "event"}
    refused(["live", str(lines), *out], "go on with --resume, or choose another folder")
    assert cli.run(["live", str(lines), *out, "--resume"]) == 0
    resumed, _ = said(capsys)
    (ready,) = [row for row in resumed if row["type"] == "ready"]
    assert ready["resumed_at"] == 7
    assert not [row for row in resumed if row["type"] == "state"]


def test_a_growing_table_is_watched_for_people(tmp_path, capsys):
    path = tmp_path / "table.csv"
    rows = [f"{0.1 * n:.1f},{n},0,1,0.5\n" for n in range(30)]
    path.write_text(HEADER + "".join(rows))
    assert cli.run(["live", str(path), "--frames", "30", "--status"]) == 0
    text = capsys.readouterr().out
    assert "mode: identifying" in text
    assert "2.0s  identifying  at (20, 0)" in text


def circle(path, start, session="a"):
    """A robot of 3 um per cycle that drives in a circle, from a place on."""
    lines, (x, y) = [encode(msgspec.structs.replace(HELLO, session=session))], start
    for n in range(150):
        heading = 0.08 * n
        lines.append(frame_line(n, x=x, y=y, frequency=1.0, heading=heading) + b"\n")
        x, y = x + 0.3 * math.cos(heading), y + 0.3 * math.sin(heading)
    path.write_bytes(b"".join([*lines, b'{"type":"bye"}\n']))
    return path


def test_an_earlier_session_tells_the_drive_of_the_next(tmp_path, capsys, refused):
    monday, tuesday = tmp_path / "monday", tmp_path / "tuesday.jsonl"
    first = circle(tmp_path / "monday.jsonl", (0.0, 0.0))
    assert cli.run(["live", str(first), "--out", str(monday)]) == 0
    rows, _ = said(capsys)
    states = [row for row in rows if row["type"] == "state"]
    assert states[0]["gain"] is None
    gain = states[-1]["gain"]
    assert gain == pytest.approx(3.0, rel=0.1)
    circle(tuesday, (50.0, 20.0), session="b")
    words = ["live", str(tuesday), "--replay"]
    assert cli.run([*words, "--prior", str(monday)]) == 0
    rows, _ = said(capsys)
    state = next(row for row in rows if row["type"] == "state")
    assert state["gain"] == pytest.approx(gain, rel=0.01)
    assert (state["x"], state["y"]) == pytest.approx((50.0, 20.0), abs=0.1)
    refused([*words, "--prior", str(tmp_path / "nobody")], "session.npz cannot be read")


def test_commands_go_to_a_file_and_stop_with_watch(lines, tmp_path, capsys):
    commands = tmp_path / "commands"
    words = ["live", str(lines), "--to", "50,0", "--commands-to", str(commands)]
    assert cli.run([*words, "--watch"]) == 0
    assert b'"command"' not in commands.read_bytes()
    assert cli.run(words) == 0
    assert b'"command"' in commands.read_bytes()


def test_a_short_secret_is_refused_and_watching_has_no_goal(tmp_path, refused):
    token = tmp_path / "token"
    token.write_text("short")
    words = ["live", "tcp://10.0.0.1:5000", "--token", str(token)]
    refused(words, "expected a secret of 8 to 200 characters")
    assert LiveSettings(to="1,2", watch=True).goal() is None
