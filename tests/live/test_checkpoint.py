"""A session that is written is read again; damage is one line."""

import dataclasses

import numpy as np
import pytest
from tests.live.sessions import Follow, LastPosition, begun, feed, frame_line

from pinav.errors import InputError
from pinav.live.checkpoint import read_session, write_session
from pinav.live.session import Session


def test_a_session_goes_on_where_it_was_kept(tmp_path):
    path = tmp_path / "session.npz"
    session, _ = feed(begun(pilot=Follow()), [frame_line(n) for n in range(5)])
    session, _ = feed(session, [b"garbage", frame_line(5, x=None)])
    write_session(path, session)
    again = read_session(path, Session(LastPosition(), Follow()))
    assert again.resumed_at == 5
    for name in ("hello", "mode", "last", "blind", "doubted", "counts"):
        assert getattr(again, name) == getattr(session, name), name
    assert [f.seq for f in again.estimator.frames] == list(range(6))
    outcome = again.after(frame_line(3))
    assert outcome.session.counts.repeated == 1


def test_the_old_checkpoint_stays_when_writing_fails(tmp_path, monkeypatch):
    path = tmp_path / "session.npz"
    write_session(path, begun())

    def fail(*args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(InputError, match="cannot write: disk full"):
        write_session(path, begun())
    assert [file.name for file in tmp_path.iterdir()] == ["session.npz"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 nothing", None])
def test_a_damaged_checkpoint_is_one_line(tmp_path, content):
    path = tmp_path / "session.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read .*begin without --resume"):
        read_session(path, begun())


def test_a_checkpoint_of_another_version_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "session.npz"
    monkeypatch.setattr("pinav.live.checkpoint.SCHEMA", 0)
    write_session(path, dataclasses.replace(begun()))
    monkeypatch.undo()
    with pytest.raises(InputError, match="version 0, expected 1"):
        read_session(path, begun())
