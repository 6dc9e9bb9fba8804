"""Each row of the fault table, and what else a line may lead to."""

import dataclasses
import random

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.live.sessions import (
    HELLO,
    Follow,
    LastPosition,
    begun,
    feed,
    frame_line,
    line,
)

from pinav.live import messages
from pinav.live.estimators import Intent
from pinav.live.session import BLIND_STEPS, REFUSED_IN_A_ROW, VALID_STEPS, Session


def events(answers, kind=None):
    return [
        a for a in answers if isinstance(a, messages.Event) and kind in (None, a.kind)
    ]


def commands(answers):
    return [a for a in answers if isinstance(a, messages.Command)]


def test_a_hello_is_answered_and_frames_are_learned_from_after_it():
    session, answers = feed(Session(LastPosition()), [line(HELLO), frame_line(0)])
    assert answers[0] == messages.Ready(version=1, session="a")
    assert isinstance(answers[1], messages.State)
    assert session.counts.frames == 1
    assert not commands(answers)
    session, answers = feed(Session(LastPosition()), [frame_line(0)])
    assert answers[0].text == "the first line must be a hello"
    assert session.counts.frames == 0


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"version": 2}, "version 2, expected 1"), ({"token": "no"}, "wrong token")],
)
def test_a_wrong_hello_ends_the_connection(change, reason):
    hello = msgspec.structs.replace(HELLO, token="secret-secret")
    session = Session(LastPosition(), token="secret-secret")
    assert not session.after(line(hello)).hang_up
    outcome = session.after(line(msgspec.structs.replace(hello, **change)))
    assert outcome.hang_up
    assert reason in outcome.answers[0].text
    assert outcome.session.hello is None


def test_garbage_is_counted_said_once_and_ends_a_connection():
    session, said, ends = begun(), [], []
    for _ in range(REFUSED_IN_A_ROW):
        outcome = session.after(b"\xff garbage")
        session = outcome.session
        said += outcome.answers
        ends.append(outcome.hang_up)
    assert ends == [False] * (REFUSED_IN_A_ROW - 1) + [True]
    assert len(said) == 2
    assert session.counts.refused == REFUSED_IN_A_ROW
    assert session.after(frame_line(0)).session.refused_in_row == 0


def test_a_frame_is_never_learned_twice():
    lines = [frame_line(n) for n in (0, 1, 2, 1, 2, 0, 3)]
    session, answers = feed(begun(), lines)
    assert [f.seq for f in session.estimator.frames] == [0, 1, 2, 3]
    assert session.counts.repeated == 3
    assert len(events(answers, messages.EventKind.REPEATED)) == 1


@pytest.mark.parametrize(
    ("t", "words"), [(0.15, "back by 0.05 s"), (0.71, "forward by 0.51 s"), (0.7, None)]
)
def test_the_state_begins_anew_when_the_clock_jumps(t, words):
    lines = [*(frame_line(n) for n in range(3)), frame_line(3, t=t)]
    session, answers = feed(begun(), lines)
    assert session.estimator.restarts == ((3,) if words else ())
    assert session.counts.jumps == (words is not None)
    assert all(words in one.text for one in events(answers, messages.EventKind.JUMP))


def test_a_lost_robot_is_predicted_and_then_stopped():
    session = begun(pilot=Follow())
    session, _ = feed(session, [frame_line(n) for n in range(3)])
    lost = [frame_line(n, x=None) for n in range(3, 12)]
    session, answers = feed(session, lost)
    frequencies = [c.frequency for c in commands(answers)]
    blind = BLIND_STEPS + 2  # the delay is two steps
    assert frequencies == [1.0] * blind + [0.0] * (len(lost) - blind)
    assert len(events(answers, messages.EventKind.LOST)) == 1
    assert session.mode is messages.Mode.HOLDING
    assert session.counts.lost == session.blind == len(lost)
    session, answers = feed(session, [frame_line(12, x=1.0)])
    assert commands(answers)[0].frequency == 1.0
    assert session.estimator.restarts == ()


def test_a_robot_that_leaps_or_comes_back_elsewhere_needs_a_second_frame():
    lost = [frame_line(0), frame_line(1, x=None)]
    session, _ = feed(begun(), lost)
    session, answers = feed(session, [frame_line(2, x=50.0)])
    assert session.estimator.restarts == ()
    assert not session.estimator.frames[-1].observed
    session, _ = feed(session, [frame_line(3, x=-90.0)])  # does not agree
    assert session.estimator.restarts == ()
    session, answers = feed(session, [frame_line(4, x=-89.0)])
    assert session.estimator.restarts == (4,)
    assert "elsewhere" in events(answers, messages.EventKind.REACQUIRED)[0].text
    lines = [frame_line(0), frame_line(1, x=14.0), frame_line(2, x=0.0)]
    session, _ = feed(begun(), lines)
    assert all(frame.observed for frame in session.estimator.frames)
    session, _ = feed(session, [frame_line(3, x=16.0), frame_line(4, x=0.0)])
    assert [f.observed for f in session.estimator.frames[3:]] == [False, True]
    assert session.estimator.restarts == ()


def test_only_the_newest_frame_is_commanded_for():
    session = begun(pilot=Follow())
    old = session.after(frame_line(0), newest=False)
    assert not commands(old.answers)
    new = old.session.after(frame_line(1))
    (command,) = commands(new.answers)
    assert (command.seq, command.for_t) == (1, 0.1)
    assert command.valid_until == pytest.approx(0.1 + 0.1 * VALID_STEPS)


def test_commands_stay_within_the_limits_and_are_finite():
    for frequency, expected in [(99.0, 3.0), (-1.0, 0.0)]:
        session = begun(pilot=Follow(frequency=frequency))
        (command,) = commands(session.after(frame_line(0)).answers)
        assert command.frequency == expected


@pytest.mark.parametrize(
    ("intent", "mode", "kind"),
    [
        (Intent.PROBE, messages.Mode.IDENTIFYING, messages.EventKind.MODE),
        (Intent.STEER, messages.Mode.STEERING, messages.EventKind.MODE),
        (Intent.ARRIVED, messages.Mode.HOLDING, messages.EventKind.ARRIVED),
        (Intent.AVOID, messages.Mode.STEERING, messages.EventKind.SAFETY),
        (Intent.UNREACHABLE, messages.Mode.HOLDING, messages.EventKind.UNREACHABLE),
        (Intent.STALLED, messages.Mode.IDENTIFYING, messages.EventKind.STALLED),
        (Intent.GIVE_UP, messages.Mode.STOPPED, messages.EventKind.STALLED),
    ],
)
def test_every_intent_has_a_mode_and_is_said_once(intent, mode, kind):
    session = begun(pilot=Follow(intent))
    session, answers = feed(session, [frame_line(n) for n in range(3)])
    assert session.mode is mode
    assert [e.kind for e in events(answers)] == [kind]


def test_after_giving_up_or_a_bye_nothing_is_commanded():
    session, _ = feed(begun(pilot=Follow(Intent.GIVE_UP)), [frame_line(0)])
    assert not commands(session.after(frame_line(1)).answers)
    session, answers = feed(begun(pilot=Follow()), [line(messages.Bye(reason="lunch"))])
    assert session.mode is messages.Mode.STOPPED
    assert "lunch" in answers[0].text
    assert not commands(session.after(frame_line(1)).answers)
    session, answers = feed(session, [line(HELLO), frame_line(2)])
    assert commands(answers)


def test_the_same_session_goes_on_after_a_new_connection_and_another_begins_anew():
    session, _ = feed(begun(), [frame_line(n) for n in range(4)])
    session, answers = feed(session, [line(HELLO), frame_line(2), frame_line(4)])
    assert answers[0].resumed_at == 3
    assert [f.seq for f in session.estimator.frames] == [0, 1, 2, 3, 4]
    other = line(msgspec.structs.replace(HELLO, session="b"))
    session, answers = feed(session, [other, frame_line(0, t=500.0)])
    assert answers[0].resumed_at is None
    assert session.estimator.restarts == (0,)


def garble(data: bytes, draw: random.Random) -> bytes:
    """A line with bytes changed, cut, doubled or put in; no newline."""
    kind = draw.randrange(5)
    place = draw.randrange(len(data))
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + bytes([draw.randrange(256)]) + data[place + 1 :]
    if kind == 2:
        return data[place:] + data
    if kind == 3:
        return bytes(draw.randrange(256) for _ in range(draw.randrange(80)))
    return data.replace(b":", draw.choice([b"", b"::", b":-", b":1e9999,", b":[[["]))


@pytest.mark.parametrize("count", [1000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_garbled_lines_leave_the_belief_unharmed(count):
    """What is no frame changes nothing; what happens to be one is a frame."""
    draw = random.Random(0)
    plain, noisy = begun(), begun()
    number = 0
    for place in range(count):
        bad = garble(frame_line(number + 1, x=1.5), draw).replace(b"\n", b"")
        outcome = noisy.after(bad)
        if outcome.session.estimator is not noisy.estimator:
            continue  # still a frame: left to the rules for frames
        noisy = dataclasses.replace(outcome.session, hello=noisy.hello)
        noisy = dataclasses.replace(noisy, mode=plain.mode)
        if place % 100 == 0:
            number += 1
            good = frame_line(number, x=float(number))
            plain, noisy = plain.after(good).session, noisy.after(good).session
    assert noisy.estimator == plain.estimator
    assert noisy.counts.frames == number >= count // 200
    assert noisy.counts.refused > count // 2


@settings(max_examples=50)
@given(st.lists(st.binary(max_size=100), max_size=20))
def test_any_bytes_lead_to_answers_that_can_be_written(lines):
    _, answers = feed(begun(), [part.replace(b"\n", b"") for part in lines])
    for answer in answers:
        assert messages.encode(answer).endswith(b"\n")


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 40), st.floats(-5, 5)), max_size=12))
def test_any_order_of_frames_is_learned_in_growing_order(rows):
    lines = [line(messages.Frame(seq=s, t=t, x=0.0, y=0.0)) for s, t in rows]
    session, _ = feed(begun(), lines)
    seqs = [frame.seq for frame in session.estimator.frames]
    assert seqs == sorted(set(seqs))
