"""`pinav discover`: the law behind the learned force of a run."""

from pathlib import Path
from typing import Any

import numpy as np

from pinav.analysis import Candidate, Discovery
from pinav.analysis import discover as discover_law
from pinav.analysis.discovery.law_regression import law_force
from pinav.analysis.discovery.learned_fit import laplace_posterior
from pinav.commands.command import CommandResult
from pinav.commands.discover.settings import DiscoverOptions
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.fitting.environments.catalogue import learned_part
from pinav.runs import RunFolder

LAWS_FILE, SAMPLE_FILE = "laws.json", "laws.npz"


def discover(run: Path, refits: int) -> dict[str, Any]:
    """Rank the laws of a run's learned force; write `laws.json` and its arrays.

    Args:
        run: folder of `pinav fit`.
        refits: number of laws refitted through the equations of motion.

    Returns:
        The content of `laws.json`.

    Raises:
        InputError: the run is no finished fit of a force.
        FitError: the learned force does not explain the trajectories.
    """
    fitted = FittedRun.open(run)
    folder = fitted.folder
    found = discover_law(_posterior(fitted), fitted.data, refits=refits)
    metrics = _metrics(found)
    best, sample = found.best, found.sample
    values = np.array([own.value for own in best.constants])
    variances = np.maximum(np.diag(sample.covariance), 0.0)
    folder.write_arrays(
        SAMPLE_FILE,
        {
            "positions": sample.positions,
            "learned": sample.force,
            "sd": np.sqrt(variances).reshape(sample.force.shape),
            "law": law_force(best.law, values, sample.positions),
        },
    )
    folder.write_json(LAWS_FILE, metrics)
    return metrics


def _posterior(fitted: FittedRun) -> Posterior:
    """The posterior that the run stored, or one by Laplace about its model."""
    if fitted.posterior is not None:
        return fitted.posterior
    model = fitted.model
    if not isinstance(model, Swimmer):
        raise InputError(
            f"{fitted.folder.path}: a black box has no force of its environment; fit "
            "another --model"
        )
    return laplace_posterior(model, fitted.data, learned_part)


def _metrics(found: Discovery) -> dict[str, Any]:
    central = found.central
    return {
        "verdict": found.verdict.value,
        "laws": [_candidate(candidate) for candidate in found.candidates],
        "screened": [list(pair) for pair in found.screened],
        "central": {
            "verdict": central.verdict.value,
            "center": list(central.center),
            "center_sd": list(central.center_sd),
            "ratio": central.ratio,
            "noise_ratio": central.noise_ratio,
            "p_value": central.p_value,
        },
        "noise": found.learned_noise,
        "num_effective": found.num_effective,
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        "name": candidate.name,
        "num_constants": len(candidate.constants),
        "bic": candidate.bic,
        "delta_bic": candidate.delta_bic,
        "noise": candidate.noise,
        "outcome": str(candidate.outcome),
        "fits": candidate.fits,
        "latex": candidate.latex,
        "sympy": candidate.sympy,
        "constants": [
            {
                "name": own.name,
                "symbol": own.symbol,
                "unit": own.unit,
                "value": own.value,
                "sd": own.sd,
                "low": own.low,
                "high": own.high,
                "identifiable": own.identifiable,
            }
            for own in candidate.constants
        ],
    }


def text(metrics: dict[str, Any]) -> str:
    """The ranking and the constants of the close laws, for a terminal."""
    laws = metrics["laws"]
    width = max(len(law["name"]) for law in laws)
    lines = [f"{'law':<{width}} constants  ΔBIC      noise     refit      explains"]
    for law in laws:
        delta = np.inf if law["delta_bic"] is None else law["delta_bic"]
        fits = "yes" if law["fits"] else "no"
        lines.append(
            f"{law['name']:<{width}} {law['num_constants']:<9}  {delta:<8.4g}  "
            f"{law['noise']:<8.3g}  {law['outcome']:<9}  {fits}"
        )
    for law in close_laws(metrics):
        lines.append(f"\n{law['name']}: {law['latex']}")
        lines += [f"  {constant_text(own)}" for own in law["constants"]]
    lines += ["", *verdict_lines(metrics)]
    return "\n".join(lines)


def close_laws(metrics: dict[str, Any]) -> list[dict[str, Any]]:
    """The laws within 6 of the lowest BIC."""
    deltas = [law["delta_bic"] for law in metrics["laws"]]
    pairs = zip(metrics["laws"], deltas, strict=True)
    return [law for law, delta in pairs if delta is not None and delta < 6.0]


def constant_text(constant: dict[str, Any]) -> str:
    """A constant with its 95 % interval, or that it is not identifiable."""
    line = f"{constant['name']} = {constant['value']:.6g}"
    low, high = constant["low"], constant["high"]
    if low is not None and np.isfinite([low, high]).all():
        line += f", 95 % from {low:.6g} to {high:.6g}"
    return line if constant["identifiable"] else f"{line}: not identifiable"


def verdict_lines(metrics: dict[str, Any]) -> list[str]:
    """What is known of the law, and whether the force is central, in sentences."""
    laws, central = metrics["laws"], metrics["central"]
    names = ", ".join(law["name"] for law in close_laws(metrics))
    sentences = {
        "identified": f"law: {names}",
        "not identifiable": f"law: not identifiable from these data ({names})",
        "no law fits": "law: no candidate explains the data as well as the learned "
        f"force; the nearest is {laws[0]['name']}",
    }
    (x, y), (sd_x, sd_y) = central["center"], central["center_sd"]
    return [
        sentences[metrics["verdict"]],
        f"central force: {central['verdict']}; tangential over radial "
        f"{central['ratio']:.3g}, {central['noise_ratio']:.3g} expected of a central "
        f"one, p = {central['p_value']:.3g}; centre ({x:.5g} ± {sd_x:.2g}, "
        f"{y:.5g} ± {sd_y:.2g})",
    ]


def run(options: DiscoverOptions) -> CommandResult:
    """Discover as the command line does."""
    metrics = discover(options.run, options.refits)
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
