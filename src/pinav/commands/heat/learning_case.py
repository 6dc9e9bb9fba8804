"""What `pinav heat` learns from which readings, checked before anything is fitted."""

import dataclasses
from pathlib import Path

import numpy as np

from pinav.commands.heat.aims import Learn
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case, read_case
from pinav.commands.heat.fitting import (
    law_names,
    movable,
    require_heating,
    value_at_rest,
)
from pinav.commands.heat.readings import Readings, read_data, readings_until
from pinav.commands.heat.simulate import spacing
from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.learning import ProbeResiduals, read_residuals
from pinav.thermal.thermometry import Thermometry, ThermometryResiduals


@dataclasses.dataclass(frozen=True)
class LearningCase:
    """What is fitted to what, and what is known of the truth.

    Attributes:
        setup: the case.
        settings: its table `learn`.
        fitted: the readings that are fitted; none where the case makes its own.
        every: all readings that there are.
        truth: of the readings, where it is known.
    """

    setup: CaseModel
    settings: Learn
    fitted: Readings | None
    every: Readings | None
    truth: CaseModel | None

    @classmethod
    def of(
        cls, case: Case, setup: CaseModel, folder: Path, until: float | None = None
    ) -> "LearningCase":
        """That of a case, up to a time [s] unless its table says one.

        Raises:
            InputError: a file cannot be read, or nothing could be learned from it.
        """
        settings = case.learn or Learn()
        for name in law_names(setup, settings):
            value_at_rest(setup, name)
        require_heating(setup)
        movable(setup, settings)  # refuses a spot on a grid where none can be moved
        data = read_data(settings, setup, folder)
        end = until or settings.until
        fitted = data if data is None or end is None else readings_until(data, end)
        if fitted is not None:
            # refuses readings outside the grid or after the end of the protocol
            residuals_of(setup, setup.model, fitted)
            _require_readings(setup, settings, fitted)
            if isinstance(fitted, Thermometry):
                _require_voxels(setup, law_names(setup, settings), fitted)
        return cls(setup, settings, fitted, data, _read_truth(settings, setup, folder))


def _require_readings(setup: CaseModel, settings: Learn, data: Readings) -> None:
    """Refuse fewer readings than numbers that are learned."""
    axes = len(setup.model.grid.shape)
    numbers = len(law_names(setup, settings)) + settings.power_scale
    numbers += axes * settings.spot
    if (count := int(data.observed.sum())) <= numbers:
        raise InputError(
            f"learn: expected more readings than the {numbers} numbers that are "
            f"learned, got {count}; read more, or learn less"
        )


def _require_voxels(
    setup: CaseModel, names: tuple[str, ...], frames: Thermometry
) -> None:
    """Refuse to learn tissue of which no voxel is read."""
    read = frames.observed.any(axis=0)
    for name in names:
        if not (read & (np.asarray(setup.body.fractions[name]) > 0.5)).any():
            raise InputError(
                f"learn.laws: expected tissues with a reading, got {name}, of which no "
                "voxel is read; leave it out"
            )


def _read_truth(settings: Learn, setup: CaseModel, folder: Path) -> CaseModel | None:
    if settings.truth is None:
        return None
    path = folder / settings.truth
    truth = build_case(read_case(path)[0], path.parent)
    given, expected = (
        f"{one.model.grid.shape} of {spacing(one.model.grid)} m"
        for one in (truth, setup)
    )
    if given != expected:
        raise InputError(
            f"learn.truth: expected a case on the cells of this one, {expected}, got "
            f"{given}; take the same"
        )
    for name in law_names(setup, settings):
        if name not in truth.body.laws:
            raise InputError(
                f"learn.truth: expected a case with the tissue {name}, got "
                f"{', '.join(truth.body.laws)}; name its tissues as here"
            )
    return truth


def residuals_of(
    setup: CaseModel, model: Bioheat, data: Readings
) -> ProbeResiduals | ThermometryResiduals:
    """Predicted less read temperatures, as a function of the model.

    Raises:
        InputError: the readings do not fit the grid or the protocol.
    """
    return read_residuals(
        model, setup.protocol, data, stepper=setup.stepper, start=setup.start
    )
