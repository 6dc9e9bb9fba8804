"""The results of `pinav design`, as `metrics.json` holds them."""

from collections.abc import Sequence

import msgspec
import numpy as np

from pinav.commands.cells import Row
from pinav.navigation.design.campaign import Campaign, Decision
from pinav.report import Table
from pinav.report.text import as_text


class DesignRow(Row, frozen=True):
    """Campaigns of one design in a simulation.

    Attributes:
        campaigns: number of them.
        finished: campaigns in which the way became known by the belief.
        trajectories: median number of trajectories until then; None where more than
            half did not finish.
        fewest: least number of trajectories of a campaign.
        largest: greatest number; campaigns that were given up count with theirs.
        reached: median number of trajectories until the true error was below the
            accuracy for the first time; None where more than half did not get there.
        right: finished campaigns whose true error was below the accuracy.
        error: median of the true relative error at the end.
    """

    campaigns: int
    finished: int
    trajectories: float | None
    fewest: int
    largest: int
    reached: float | None
    right: int
    error: float | None

    @classmethod
    def of_campaigns(cls, campaigns: Sequence[Campaign]) -> "DesignRow":
        """The row of the campaigns of one design."""
        counts = np.array([len(one.paths) for one in campaigns])
        finished = np.array([one.finished for one in campaigns])
        ends = np.where(finished, counts, np.inf)
        reached = np.array([_first_below(one) for one in campaigns])
        errors = [d.true_error for d in (one.decisions[-1] for one in campaigns)]
        return cls(
            campaigns=len(campaigns),
            finished=int(finished.sum()),
            trajectories=_median(ends),
            fewest=int(counts.min()),
            largest=int(counts.max()),
            reached=_median(reached),
            right=sum(one.right is True for one in campaigns),
            error=_median(np.array([np.nan if e is None else e for e in errors])),
        )


class NextRow(Row, frozen=True):
    """What recordings of a lab leave open.

    Attributes:
        trajectories: number of recorded ones.
        arrives: whether the plan on the learned force reaches the goal.
        error: bound of the relative error of the force along the way (95 %).
        certain: whether nothing further need be recorded.
        sd: standard deviation of the force along the way now.
        sd_after: the same, expected after the suggested trajectory.
        start: where the suggested trajectory is released [L].
    """

    trajectories: int
    arrives: bool
    error: float
    certain: bool
    sd: float
    sd_after: float | None = None
    start: tuple[float, float] | None = None


class DesignMetrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The numbers of a design.

    Attributes:
        system: its name.
        accuracy: relative error of the force along the way that is small enough.
        designs: simulated campaigns by the name of their design.
        next: what recordings leave open, with --data.
    """

    system: str
    accuracy: float
    designs: dict[str, DesignRow] = {}
    next: NextRow | None = None

    def sentences(self) -> list[str]:
        """The findings in words."""
        if self.next is not None:
            return [_next_sentence(self.next, self.accuracy)]
        lines = [
            f"System {self.system} (synthetic): trajectories until the force along the "
            f"planned way is known to {100 * self.accuracy:g} % with a probability of "
            "95 %, by the belief."
        ]
        informed = self.designs.get("informed")
        for name, row in self.designs.items():
            if name == "informed" or informed is None or not informed.trajectories:
                continue
            if row.trajectories is None:
                lines.append(f"Most {name} campaigns were given up.")
            else:
                ratio = informed.trajectories / row.trajectories
                lines.append(
                    f"The informed design took {100 * ratio:.0f} % of the trajectories "
                    f"of the {name} one (medians)."
                )
        return lines

    def table(self) -> Table:
        """One row for each design."""
        columns = {
            "campaigns": lambda row: row.campaigns,
            "finished": lambda row: row.finished,
            "trajectories": lambda row: row.trajectories,
            "fewest": lambda row: row.fewest,
            "largest": lambda row: row.largest,
            "until truly known": lambda row: row.reached,
            "right when finished": lambda row: row.right,
            "true error at the end": lambda row: row.error,
        }
        rows = [
            (name, *(column(row) for column in columns.values()))
            for name, row in self.designs.items()
        ]
        return Table(("design", *columns), rows, CAPTION)

    def text(self) -> str:
        """The findings for a terminal."""
        table = [as_text(self.table())] if self.designs else []
        return "\n".join([*table, *self.sentences()])


CAPTION = (
    "Finished: the force along the way was known well enough by the belief; "
    "trajectories: median until then, a dash where more than half were given up; until "
    "truly known: median until the true error was below the accuracy for the first "
    "time; right when finished: campaigns whose true error was then below it."
)


def relative_bound(decision: Decision) -> float:
    """The bound of an error, at most 1: nothing is known of the force."""
    return min(decision.error, 1.0)


def _next_sentence(row: NextRow, accuracy: float) -> str:
    known = (
        f"After {row.trajectories} trajectories the force along the planned way is "
        f"known to {100 * row.error:.2g} % with a probability of 95 %"
    )
    if row.certain:
        return f"{known}; nothing further need be recorded for {100 * accuracy:g} %."
    if not row.arrives:
        known = (
            f"After {row.trajectories} trajectories no plan reaches the goal on the "
            "learned force"
        )
    if row.start is None or row.sd_after is None:
        return f"{known}; no candidate trajectory stays inside of the arena."
    x, y = row.start
    return (
        f"{known}. Record next the trajectory in next.csv, released at ({x:.4g}, "
        f"{y:.4g}): the standard deviation of the force along the way, now "
        f"{row.sd:.3g}, should then be {row.sd_after:.3g}."
    )


def _first_below(campaign: Campaign) -> float:
    for count, decision in enumerate(campaign.decisions):
        error = decision.true_error
        if decision.arrives and error is not None and error <= campaign.accuracy:
            return float(count)
    return np.inf


def _median(values: np.ndarray) -> float | None:
    """The lower median; None where it is not finite."""
    middle = float(np.quantile(values, 0.5, method="inverted_cdf"))
    return middle if np.isfinite(middle) else None
