"""Tables of a case that say what is asked: to learn, and to plan."""

from typing import Annotated, Literal

from msgspec import Meta

from pinav.thermal.quantities import (
    NOISIEST,
    Celsius,
    Fraction,
    Noise,
    Reference,
    Seed,
    Strict,
    Time,
)


class Frames(Strict, frozen=True):
    """MR thermometry: an image with frames, its noise [K], turns and drift.

    `temperature` in °C, `rise` in kelvins above the arteries, or `phase` in radians
    since the field was off, with the field of the magnet [T] and the echo time [s].
    `every` [s] is the time between frames, the first of which is as late; unless the
    file has it.
    """

    readings: str
    noise: Annotated[float, Meta(gt=0, le=NOISIEST)] | str
    quantity: Literal["temperature", "rise", "phase"] = "temperature"
    every: Time | None = None
    turn: Annotated[float, Meta(gt=0, le=1e4)] | None = None
    drift: Literal["none", "constant", "linear"] = "linear"
    magnet: Annotated[float, Meta(ge=0.01, le=30)] | None = None
    echo: Annotated[float, Meta(ge=1e-4, le=1)] | None = None
    coefficient: Annotated[float, Meta(ge=-1e-6, lt=0)] = -1e-8

    def __post_init__(self) -> None:
        phase = self.quantity == "phase"
        if phase is (self.magnet is None) or phase is (self.echo is None):
            raise ValueError(
                "expected magnet and echo with a phase, and with nothing else; give "
                "tesla and seconds, or remove them"
            )
        if phase and self.turn is not None:
            raise ValueError(
                "turn: expected none with a phase, whose turn follows from magnet and "
                "echo; remove it"
            )


class Learn(Strict, frozen=True):
    """What is learned, from probes, from voxels or from synthetic readings of the case.

    `power_scale` and `spot` are a factor of the power and where its map is; `until` [s]
    ends the readings that are fitted; `truth` is a case whose numbers made them.
    """

    laws: tuple[str, ...] | None = None
    kind: Literal["kernels", "network", "constant"] = "kernels"
    data: str | None = None
    thermometry: Frames | None = None
    noise: Noise = 0.1
    seed: Seed = 0
    power_scale: bool = False
    spot: bool = False
    until: Time | None = None
    truth: str | None = None
    held_out: tuple[Annotated[float, Meta(gt=0, le=100)], ...] = ()

    @property
    def is_synthetic(self) -> bool:
        """Whether the case itself is the truth of its readings."""
        return self.data is None and self.thermometry is None

    def __post_init__(self) -> None:
        if len(set(self.laws or ())) < len(self.laws or ()):
            raise ValueError(f"laws: expected each once, got {list(self.laws or ())}")
        if self.laws == () and not (self.power_scale or self.spot):
            raise ValueError(
                "expected something to learn, got no laws, power_scale or spot; name a "
                "tissue in laws"
            )
        if self.data is not None and self.thermometry is not None:
            raise ValueError("expected data or thermometry, got both; remove one")
        if self.held_out and not self.is_synthetic:
            raise ValueError(
                "held_out: expected none with data, whose truth is unknown; remove it"
            )
        if self.is_synthetic and (self.truth or self.until):
            raise ValueError(
                "truth, until: expected with data or thermometry alone; remove them"
            )


class Optimise(Strict, frozen=True):
    """What is free and what is bounded; temperatures in °C, doses in CEM43 minutes.

    The field is free `after` a time [s], at which it may switch; readings of `learn`
    until then say what the tissue is like.
    """

    largest: Reference
    start: Fraction = 0.5
    max_temperature: Celsius = 47.0
    healthy_dose: Annotated[float, Meta(gt=0, le=1e9)] | None = None
    margin: Annotated[float, Meta(ge=0, le=10)] = 0.003
    placement: Annotated[int, Meta(ge=2, le=100)] | None = None
    after: Time | None = None
