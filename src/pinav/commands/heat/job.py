"""`pinav heat`: simulate a case, or optimise its protocol."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.heat.build import CaseModel, build_case
from pinav.commands.heat.case import Case, read_case
from pinav.commands.heat.command import HEAT
from pinav.commands.heat.learn import learn_perfusion
from pinav.commands.heat.settings import HeatOptions
from pinav.commands.heat.tables import text, validation_rows, validation_table
from pinav.errors import InputError
from pinav.report.text import as_text
from pinav.runs import RunFolder
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.constraints import (
    AbstractConstraint,
    HealthyDose,
    LogD90,
    MaxTemperature,
    limit_constraint,
)
from pinav.thermal.design_variables import (
    AbstractDesignVariable,
    FreeAmplitudes,
    FreePlacement,
    Run,
    shells,
)
from pinav.thermal.dose import exceeded_by, volume_above
from pinav.thermal.exposure_limits import require, validity_warnings
from pinav.thermal.optimise import optimise
from pinav.thermal.protocols import Piecewise
from pinav.thermal.solve import Probes, Solution, solve
from pinav.thermal.verification import validate

RESULTS = "results.npz"
NUM_PROFILES = 7
"""Times at which temperature profiles are kept."""


def simulate(case: Case, folder: RunFolder) -> dict[str, Any]:
    """Run a case; write its metrics and arrays.

    Raises:
        InputError: the protocol exceeds the limit that the case chose.
    """
    own = build_case(case)
    require(own.protocol, *own.limits)
    metrics, arrays = _simulate(own, own.model, own.protocol)
    folder.write_arrays(RESULTS, arrays)
    folder.write_json("metrics.json", {"task": "simulate", **metrics})
    return {"task": "simulate", **metrics}


def _simulate(
    own: CaseModel, model: Bioheat, protocol: Piecewise
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a run reached, and the arrays behind its figures."""
    probes = Probes(model.grid.interpolation(own.points)) if len(own.points) else None
    radial = len(model.grid.shape) == 1

    def observe(temperature):
        kept = {"hottest": jnp.max(temperature)}
        if probes is not None:
            kept["probes"] = probes(temperature)
        if radial:
            kept["field"] = temperature
        return kept

    found = solve(
        model,
        protocol,
        stepper=own.stepper,
        observe=observe,
        save_every=protocol.duration / 180,
    )
    arrays = {
        "times": np.asarray(found.times),
        "temperature": np.asarray(found.final.temperature),
        "dose": np.asarray(found.final.dose),
        "target": np.asarray(own.target),
        "edges": np.array(protocol.edges),
        "starts": np.asarray(protocol.starts),
        "ends": np.asarray(protocol.ends),
        **{name: np.asarray(values) for name, values in found.observed.items()},
    }
    if radial:
        arrays["radius"] = np.asarray(model.grid.distances())
    else:
        halves = [model.grid.half_widths(axis) for axis in range(own.target.ndim)]
        arrays["spacing"] = np.array([2 * float(h.reshape(-1)[0]) for h in halves])
    metrics = outcome_metrics(model, protocol, own.target, found)
    return metrics, arrays


def outcome_metrics(
    model: Bioheat, protocol: Piecewise, target: jax.Array, found: Solution
) -> dict[str, Any]:
    """What a run did to target and healthy tissue."""
    volumes = target * model.grid.volumes
    final, dose = found.final.temperature, found.final.dose
    hottest = float(found.hottest.max())
    outside = jnp.where(target < 1e-9, dose, 0.0)
    return {
        "T_max": hottest,
        **{f"T{p}": float(exceeded_by(final, volumes, p / 100)) for p in (10, 50, 90)},
        "D90": float(exceeded_by(dose, volumes, 0.9)),
        "V43": float(volume_above(final, volumes, 43.0)),
        "healthy_dose": float(outside.max()),
        "Hf": float(protocol.largest * float(protocol.frequency)),
        "imbalance": float(found.energy.imbalance),
        "doubts": validity_warnings(model, protocol, hottest),
    }


def optimise_protocol(case: Case, folder: RunFolder) -> dict[str, Any]:
    """Find the protocol of a case of most dose; write it beside the constant one.

    Raises:
        InputError: the case says not what is free.
        FitError: no protocol keeps the constraints.
    """
    if case.optimise is None:
        raise InputError("optimise: expected a table [optimise] in the case, got none")
    own, asked = build_case(case), case.optimise
    intervals = len(own.protocol.edges) - 1
    variables: list[AbstractDesignVariable] = [
        FreeAmplitudes(float(asked.largest), intervals, float(asked.start))
    ]
    if asked.placement is not None:
        radius = float(case.tumour.radius)
        first = own.model.sources[0]
        total = float(jnp.sum(first.shape(own.model.grid) * own.model.grid.volumes))
        patterns = shells(own.model, radius, asked.placement, total)
        variables.append(FreePlacement(patterns))
    constraints: list[AbstractConstraint] = [
        MaxTemperature(bound=float(asked.max_temperature))
    ]
    if asked.healthy_dose is not None:
        center = case.tumour.center
        grown = float(case.tumour.radius + asked.margin)
        away = 1 - own.model.grid.ball(grown, center=center)
        constraints.append(HealthyDose(bound=float(asked.healthy_dose), share=away))
    constraints += [limit_constraint(limit) for limit in own.limits]
    treated = Run(own.model, own.protocol)
    best = optimise(
        treated,
        variables,
        maximise=LogD90(own.target),
        subject_to=constraints,
        stepper=own.stepper,
    )
    metrics, arrays = _simulate(own, best.run.model, best.run.protocol)
    metrics |= {
        "outcome": best.outcome.name.lower(),
        "evaluations": best.evaluations,
        "start_D90": float(np.exp(best.start_value)),
        "constraints": [
            {
                "name": kept.name,
                "value": kept.value,
                "bound": kept.bound,
                "unit": kept.unit,
                "active": kept.active,
            }
            for kept in best.constraints
        ],
        "amplitudes": np.asarray(best.run.protocol.starts).tolist(),
        "max_temperature": float(asked.max_temperature),
    }
    folder.write_arrays(RESULTS, arrays)
    folder.write_json("metrics.json", {"task": "optimise", **metrics})
    return {"task": "optimise", **metrics}


def run(options: HeatOptions) -> CommandResult:
    """Run a task of bioheat as the command line does."""
    if options.case is None:
        return _verify()
    case, content = read_case(options.case)
    build_case(case)  # refuses a bad case before the folder is made
    config = {"run": {"command": HEAT.name, "task": options.task}, "case": content}
    folder = RunFolder.create(options.out, config, overwrite=options.overwrite)
    if options.task == "simulate":
        metrics = simulate(case, folder)
    elif options.task == "learn":
        metrics = learn_perfusion(case, folder, options.case)
    else:
        metrics = optimise_protocol(case, folder)
    return CommandResult(metrics, text(metrics), folder)


def _verify() -> CommandResult:
    checks = validate()
    missed = [check.case for check in checks if not check.passed]
    return CommandResult(
        validation_rows(checks),
        as_text(validation_table(checks)),
        failure=f"outside their tolerance: {', '.join(missed)}" if missed else "",
    )
