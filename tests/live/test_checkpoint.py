"""A session that is written is read again; damage is one line."""

import dataclasses

import msgspec
import pytest
from tests.live import sessions

from pinav.errors import InputError
from pinav.live.checkpoint import read_session, with_drive_of, write_session
from pinav.live.session import Session


def test_a_session_goes_on_where_it_was_kept(tmp_path):
    path = tmp_path / "session.npz"
    session, _ = sessions.feed(
        sessions.begun(pilot=sessions.Follow()),
        [sessions.frame_line(n) for n in range(5)],
    )
    session, _ = sessions.feed(session, [b"garbage", sessions.frame_line(5, x=None)])
    write_session(path, session)
    again = read_session(path, Session(sessions.LastPosition(), sessions.Follow()))
    assert again.resumed_at == 5
    for name in ("hello", "mode", "last", "blind", "doubted", "counts"):
        assert getattr(again, name) == getattr(session, name), name
    assert [f.seq for f in again.estimator.frames] == list(range(6))
    outcome = again.after(sessions.frame_line(3))
    assert outcome.session.counts.repeated == 1


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 nothing", None])
def test_a_damaged_checkpoint_is_one_line(tmp_path, content):
    path = tmp_path / "session.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read .*begin without it"):
        read_session(path, sessions.begun())


def test_a_checkpoint_of_another_version_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "session.npz"
    monkeypatch.setattr("pinav.live.checkpoint.SCHEMA", 0)
    write_session(path, dataclasses.replace(sessions.begun()))
    monkeypatch.undo()
    with pytest.raises(InputError, match="version 0, expected 4"):
        read_session(path, sessions.begun())


def kept(path, **more):
    """A session whose robot was driven, in a file."""
    lines = [sessions.frame_line(n, x=1.0 * n, frequency=2.0) for n in range(5)]
    session, _ = sessions.feed(sessions.begun(**more), lines)
    write_session(path, session)
    return session


class Driven(sessions.LastPosition):
    """A robot that was driven, whatever the frames say."""

    @property
    def driven(self):
        return True


def test_an_earlier_drive_is_known_and_the_state_begins_anew(tmp_path):
    path = tmp_path / "session.npz"
    kept(path)
    session = with_drive_of(path, Session(Driven()))
    assert session.last is None
    assert session.counts.frames == 0
    refused = session.after(sessions.frame_line(0))
    assert refused.session.counts.refused == 1
    greeted = session.after(sessions.line(sessions.HELLO)).session
    learned = greeted.after(sessions.frame_line(0, t=0.0, x=70.0)).session
    assert learned.estimator.restarts == (0,)
    assert len(learned.estimator.frames) == 6
    assert learned.counts.frames == 1
    kept(path)
    session = with_drive_of(path, Session(Driven()))
    hello = msgspec.structs.replace(sessions.HELLO, units="mm")
    outcome = session.after(sessions.line(hello))
    assert outcome.hang_up
    assert "lengths in mm, expected um of --prior" in outcome.answers[0].text
    write_session(path, sessions.begun())
    with pytest.raises(InputError, match="had not seen the robot driven"):
        with_drive_of(path, Session(sessions.LastPosition()))
