"""Runs the contestants one after the other, scores them, and prints the table."""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import msgspec
import numpy as np
import tyro

from benchmarks._options import begin, read_arrays, read_kept
from benchmarks.fit import table
from benchmarks.fit.contestants import BY_NAME, CONTESTANTS, Contestant, Effort
from benchmarks.fit.problem import physics_file
from benchmarks.fit.table import Measured, Measurement
from pinav.commands.settings import Settings
from pinav.errors import InputError
from pinav.files import write_text, write_whole

ROOT = Path(__file__).parents[2]


class Options(Settings, frozen=True):
    """Compare fits: the paper's recipe, other tools and ours, in one table.

    Every contestant and seed trains in a cold process of its own, strictly one after
    the other. What has finished in --out is not run again. Needs the extra packages of
    pip install 'pinav[bench]' for all rows; without them, rows say so.
    """

    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-fit"
    )
    seeds: Annotated[
        tuple[int, ...], tyro.conf.arg(help="Seeds of the networks and of the noise.")
    ] = (0, 1, 2)
    only: Annotated[
        tuple[str, ...],
        tyro.conf.arg(help="Contestants to run: " + ", ".join(BY_NAME) + "."),
    ] = tuple(BY_NAME)
    effort: Effort = Effort()

    def check_together(self) -> None:
        """Raise `InputError` where an option makes no sense."""
        for name in self.only:
            if name not in BY_NAME:
                known = ", ".join(BY_NAME)
                raise InputError(
                    f"--only: {name!r} is unknown; choose some of: {known}"
                )
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise InputError("--seeds: expected one or more, each once")
        for name in ("adam_steps", "gauss_newton_steps", "marquardt_steps"):
            if getattr(self.effort, name) < 1:
                option = name.replace("_", "-")
                raise InputError(f"--{option}: expected 1 or more")


def main(argv: Sequence[str]) -> None:
    options = begin(Options, argv, "fit")
    if options is None:
        return
    compare(options)


def compare(options: Options) -> None:
    """Run what is not there yet; print and write the results after the last one."""
    options.out.mkdir(parents=True, exist_ok=True)
    _check_settings(options)
    chosen = [c for c in CONTESTANTS if c.name in options.only]
    found: dict[str, list[Measurement]] = {c.name: [] for c in chosen}
    absent: dict[str, str] = {}
    for contestant in chosen:
        if contestant.missing():
            absent[contestant.name] = "skipped: pip install 'pinav[bench]'"
            continue
        for seed in options.seeds if contestant.seeded else (0,):
            outcome = measured(contestant, seed, options)
            if isinstance(outcome, str):
                absent[contestant.name] = f"failed: {outcome}"
            else:
                found[contestant.name].append(outcome)
    rows = [table.row(BY_NAME[name], ms) for name, ms in found.items() if ms]
    curves = _curves(options, found)
    _write(options, found, rows)
    print(table.text(rows, absent))
    print("\n".join(["", *table.verdicts(rows)]))
    if curves:
        _draw(options, curves)


def measured(contestant: Contestant, seed: int, options: Options) -> Measurement | str:
    """Measurement and scores of one contestant and seed, or why there are none.

    A finished one is read from its file, which is written last.
    """
    file = options.out / f"{contestant.name}-{seed}.json"
    if not file.exists():
        failure = _train(contestant, seed, file, options)
        if failure:
            return failure
    measurement = read_kept(file, Measurement)
    if measurement.rmse is None:
        from benchmarks.fit.scores import scores
        from pinav.scenarios import scenario

        arrays = read_arrays(file.with_suffix(".npz"))
        errors = scores(scenario(contestant.scenario), arrays)
        measurement = msgspec.structs.replace(measurement, **errors)
        write_text(file, _as_json(measurement), overwrite=True)
    return measurement


def _train(contestant: Contestant, seed: int, file: Path, options: Options) -> str:
    """Run the process of one contestant and write what it measured; or what failed."""
    print(f"{contestant.label}, seed {seed} ...", file=sys.stderr, flush=True)
    noise_seed = seed if contestant.scenario == "barrier-crossings" else 0
    data = problem_file(contestant.scenario, noise_seed, options.out)
    result = file.with_suffix(".npz")
    start = time.perf_counter()
    done = _run_child(contestant, seed, data, result, options.effort)
    cold = time.perf_counter() - start
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["no message"]
        return f"exit status {done.returncode}: {lines[-1]}"
    said = msgspec.json.decode(done.stdout.splitlines()[-1], type=Measured)
    numbers = msgspec.structs.asdict(said)
    write_text(file, _as_json(Measurement(seed=seed, cold_seconds=cold, **numbers)))
    return ""


def _as_json(content: Any) -> str:
    return msgspec.json.format(msgspec.json.encode(content), indent=2).decode()


def _run_child(contestant, seed, data, result, effort):
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.fit.child"]
    command += [repr(time.time()), contestant.name, str(seed), str(data), str(result)]
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [*command, msgspec.json.encode(effort).decode()],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
    )


def problem_file(name: str, seed: int, folder: Path) -> Path:
    """The trajectories of a scenario, and the known physics beside them."""
    file = folder / f"data-{name}-{seed}.npz"
    if physics_file(file).exists():
        return file.resolve()
    from pinav.scenarios import scenario
    from pinav.trajectories import save, simulate

    chosen = scenario(name)
    known = chosen.swimmer
    data = simulate(chosen, key=jax.random.key(seed))
    save(data, file, overwrite=True)
    at_rest = jax.numpy.zeros(2)
    arrays = {
        "times": data.times[0],
        "states": data.states,
        "damping": known.drag.damping,  # pyright: ignore
        "thrust": np.asarray(known.propulsion(0.0, at_rest, at_rest)),
        "noise": chosen.noise,
    }
    write_whole(physics_file(file), lambda to: np.savez(to, **arrays))
    return file.resolve()


def _check_settings(options: Options) -> None:
    """Results of another effort must not mix with these."""
    file = options.out / "effort.json"
    content = msgspec.json.encode(options.effort).decode()
    if not file.exists():
        write_text(file, content)
    elif file.read_bytes() != content.encode():
        raise InputError(
            f"--out {options.out}: holds results of other steps or seconds; choose "
            "another folder"
        )


def _write(options: Options, found, rows) -> None:
    write_text(options.out / "results.json", _as_json(found), overwrite=True)
    write_text(options.out / "results.csv", table.as_csv(rows), overwrite=True)


def _curves(
    options: Options, found: dict[str, list[Measurement]]
) -> dict[str, np.ndarray]:
    """Error over time of the first seed of each contestant that has one."""
    curves = {}
    for name, measurements in found.items():
        for measurement in measurements[:1]:
            path = options.out / f"{name}-{measurement.seed}.npz"
            curve = read_arrays(path).get("curve", np.zeros((0, 2)))
            number = np.issubdtype(curve.dtype, np.floating)
            plane = curve.ndim == 2 and curve.shape[1] == 2
            if not (number and plane and np.all((curve > 0) & (curve < LOST))):
                raise InputError(
                    f"{path}: expected a curve of seconds and errors > 0; delete all "
                    "files of that name and repeat the benchmark"
                )
            if len(curve):
                curves[name] = curve
    return curves


LOST = 1e100
"""An error that no fit has."""


def _draw(options: Options, curves: dict[str, np.ndarray]) -> None:
    """The figure of the curves."""
    from benchmarks.fit.convergence import figure
    from pinav.figures.images import save_figure

    files = save_figure(figure(curves), options.out, "convergence")
    print(f"figure: {files.png}")
