"""Progress of a fit: a bar for people, a line of JSON for the record."""

from typing import Any

import numpy as np
from tqdm import tqdm

from pinav.fitting import EvidenceProgress, FitProgress
from pinav.learning.learn import Progress, RoundProgress
from pinav.runs import RunFolder

OPEN_END = "{desc}: {n_fmt} steps [{elapsed}{postfix}]"
"""Format of a bar whose end is not known."""


class Reporter:
    """A bar while a fit runs, closed whatever ends it, and its record in the run.

    Attributes:
        folder: where `metrics.jsonl` is appended.
        label: name of the model that is fitted.
    """

    def __init__(self, folder: RunFolder, label: str) -> None:
        self.folder, self.label = folder, label
        self.bar = tqdm(
            desc=f"{label}: preparing and compiling",
            unit="step",
            leave=True,
            dynamic_ncols=True,
            bar_format=OPEN_END,
        )

    def __enter__(self) -> "Reporter":
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.close()

    def __call__(self, progress: Progress) -> None:
        """Take note of a step, a chunk of steps or a round."""
        if isinstance(progress, FitProgress):
            self._note_chunk(progress)
        elif isinstance(progress, EvidenceProgress):
            self._note_step(progress)
        else:
            self._note_round(progress)

    def _note_chunk(self, progress: FitProgress) -> None:
        """The stage, the loss and the time left."""
        last = progress.losses[:, -1]
        if self.bar.total is None:
            done_before = progress.done - progress.losses.shape[1]
            self.bar.bar_format = None
            self.bar.reset(total=progress.total)
            self.bar.initial = self.bar.n = done_before  # resumed: rate without it
        self._show(
            f"{self.label} {progress.phase}",
            f"loss {np.median(last):.3g}",
            progress.done - self.bar.n,
        )
        self._record(self.label, progress.done, phase=progress.phase, loss=last)

    def _note_step(self, progress: EvidenceProgress) -> None:
        label = progress.force or self.label
        self._show(
            label,
            f"{progress.parameters} unknowns, noise {progress.noise:.3g}, log evidence "
            f"{progress.log_evidence:.1f}, defect {progress.defect:.0e}",
        )
        self._record(
            label,
            progress.done,
            unknowns=progress.parameters,
            noise=progress.noise,
            log_evidence=progress.log_evidence,
            defect=progress.defect,
        )

    def _note_round(self, progress: RoundProgress) -> None:
        """A round in which noise and prior of a field are chosen in turn."""
        label = self.label if progress.field else "without a field"
        likelihood = progress.log_likelihood
        self._show(label, f"log likelihood {likelihood:.1f}")
        self._record(label, progress.done, log_likelihood=likelihood)

    def _show(self, label: str, state: str, steps: int = 1) -> None:
        self.bar.set_description_str(label, refresh=False)
        self.bar.set_postfix_str(state, refresh=False)
        self.bar.update(steps)

    def _record(self, label: str, step: int, **numbers: Any) -> None:
        self.folder.append_record({"model": label, "step": step, **numbers})
