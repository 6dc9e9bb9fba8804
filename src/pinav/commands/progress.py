"""Progress of a fit: a bar for people, a line of JSON for the record."""

import abc
from types import TracebackType
from typing import Any

import numpy as np
from tqdm import tqdm

from pinav.fitting import EvidenceProgress, FitProgress
from pinav.runs import RunFolder

OPEN_END = "{desc}: {n_fmt} steps [{elapsed}{postfix}]"
"""Format of a bar whose end is not known."""


class AbstractReporter(abc.ABC):
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

    def __enter__(self) -> "AbstractReporter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.bar.close()

    @abc.abstractmethod
    def __call__(self, progress: Any) -> None:
        """Take note of what was done since the last call."""


class FitReporter(AbstractReporter):
    """Shows a fit's stage, loss and time left, and appends its losses to the run."""

    def __call__(self, progress: FitProgress) -> None:
        """Take note of one finished chunk."""
        last = progress.losses[:, -1]
        if self.bar.total is None:
            done_before = progress.done - progress.losses.shape[1]
            self.bar.bar_format = None
            self.bar.reset(total=progress.total)
            self.bar.initial = self.bar.n = done_before  # resumed: rate without it
        self.bar.set_description(f"{self.label} {progress.phase}", refresh=False)
        self.bar.set_postfix_str(f"loss {np.median(last):.3g}", refresh=False)
        self.bar.update(progress.done - self.bar.n)
        self.folder.append_record(
            {
                "model": self.label,
                "phase": progress.phase,
                "step": progress.done,
                "loss": last,
            }
        )


class BayesReporter(AbstractReporter):
    """Shows the steps of a Bayesian fit, and appends them to the run."""

    def __call__(self, progress: EvidenceProgress) -> None:
        """Take note of one step."""
        label = progress.force or self.label
        self.bar.set_description_str(label, refresh=False)
        self.bar.set_postfix_str(
            f"{progress.parameters} unknowns, noise {progress.noise:.3g}, log evidence "
            f"{progress.log_evidence:.1f}, defect {progress.defect:.0e}",
            refresh=False,
        )
        self.bar.update(1)
        self.folder.append_record(
            {
                "model": label,
                "step": progress.done,
                "unknowns": progress.parameters,
                "noise": progress.noise,
                "log_evidence": progress.log_evidence,
                "defect": progress.defect,
            }
        )


class RoundReporter(AbstractReporter):
    """Shows the rounds in which noise and prior of a field are chosen in turn."""

    def __call__(self, progress: tuple[int, float]) -> None:
        """Take note of one round: its number and the log likelihood."""
        done, likelihood = progress
        self.bar.set_description_str(self.label, refresh=False)
        self.bar.set_postfix_str(f"log likelihood {likelihood:.1f}", refresh=False)
        self.bar.update(1)
        self.folder.append_record(
            {"model": self.label, "step": done, "log_likelihood": likelihood}
        )
