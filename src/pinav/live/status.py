"""Lines for a terminal: the protocol itself, or what a person wants to know."""

from collections.abc import Callable

from pinav.live.messages import Event, FromPinav, State, encode

STATUS_EVERY = 1.0
"""Seconds of the rig's clock between two lines for people."""


class Printer:
    """Prints what is said.

    Attributes:
        write: takes a text, and passes it on at once.
        people: lines for people instead of lines of the protocol.
    """

    def __init__(self, write: Callable[[str], object], *, people: bool = False) -> None:
        self.write = write
        self.people = people
        self._last: float | None = None

    def show(self, answer: FromPinav) -> None:
        """Print an answer, if it is one of those that are printed."""
        text = self._for_people(answer) if self.people else encode(answer).decode()
        if text:
            self.write(text)

    def _for_people(self, answer: FromPinav) -> str:
        if isinstance(answer, Event):
            return f"{_clock(answer.t)}  ! {answer.kind}: {answer.text}\n"
        if not isinstance(answer, State):
            return ""
        if self._last is not None and 0 <= answer.t - self._last < STATUS_EVERY:
            return ""
        self._last = answer.t
        return f"{status_line(answer)}\n"


def status_line(state: State) -> str:
    """What is believed, in a line."""
    parts = [f"{_clock(state.t)}  {state.mode:<11}"]
    if state.x is not None and state.y is not None:
        sd = "" if state.sd is None else f" ± {state.sd:.2g}"
        parts.append(f"at ({state.x:.4g}, {state.y:.4g}){sd}")
    if state.gain is not None and state.gain_sd is not None:
        parts.append(f"gain {state.gain:.3g} ± {state.gain_sd:.1g}")
    if state.offset is not None and state.delay is not None:
        parts.append(f"offset {state.offset:.2f} rad, delay {state.delay:.2f} s")
    if state.drift is not None:
        parts.append(f"drift ({state.drift[0]:.2g}, {state.drift[1]:.2g})")
    if state.force is not None:
        parts.append(f"force ({state.force[0]:.2g}, {state.force[1]:.2g})")
    if state.time_to_go is not None:
        parts.append(f"{state.time_to_go:.1f} s to go")
    return "  ".join(parts)


def _clock(t: float | None) -> str:
    return "        -" if t is None else f"{t:8.1f}s"
