"""The loop keeps what it learned while many lines wait."""

import dataclasses

import pytest
from tests.live.sessions import LastPosition, begun, frame_line

from pinav.live import loop as module
from pinav.live.checkpoint import read_session
from pinav.live.loop import Loop
from pinav.live.session import Session
from pinav.live.sources import FileSink, FileSource, Reading


class Killed(BaseException):
    """What nothing catches."""


class Mortal(LastPosition):
    """Is killed at its fifth frame."""

    def after(self, frame):
        if len(self.frames) == 4:
            raise Killed
        return super().after(frame)


def test_a_kill_amid_lines_that_came_at_once_loses_those_of_a_second_only(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(module, "CHECKPOINT_EVERY", 0.0)
    session = dataclasses.replace(begun(), estimator=Mortal())
    source, sink = FileSource(tmp_path / "in"), FileSink(tmp_path / "out")
    kept = tmp_path / "session.npz"
    loop = Loop(session, source, sink, lambda answer: None, kept)
    lines = b"".join(frame_line(number) + b"\n" for number in range(10))
    with pytest.raises(Killed):
        loop.take(Reading(lines))
    source.close()
    again = read_session(kept, Session(LastPosition()))
    assert [frame.seq for frame in again.estimator.frames] == [0, 1, 2, 3]
