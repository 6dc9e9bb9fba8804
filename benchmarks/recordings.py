"""Every recording of a folder through `pinav inspect` and `pinav fit`, cold.

Run with `python -m benchmarks recordings`. Each command is a process of its own without
a store of compiled code, so that import and compilation count. Nothing is set by hand
but what a file cannot know: the scale and frame rate of files in pixels and frames,
where their notes give them.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tyro

from pinav.commands.parsing import parse
from pinav.errors import InputError
from pinav.files import write_text
from pinav.identification import Identification
from pinav.identification.identify import pooled_coverage
from pinav.runs import RunFolder

KNOWN = {
    "ecoli_pillars_trackmate": ("fps=20", "mpp=0.656"),
}
"""How the files of a folder are read, from the notes of the recordings."""

COLD = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
"""Of a first run: nothing was compiled before."""

ENDINGS = (".csv", ".csv.gz", ".xlsx")


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Time `pinav inspect` and `pinav fit` on every recording, and score the fits."""

    folder: Annotated[
        Path, tyro.conf.arg(help="Folder of the recordings; searched for files.")
    ] = Path(os.environ.get("PINAV_RECORDINGS", "../shared/data"))
    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-recordings"
    )
    only: Annotated[str, tyro.conf.arg(help="Only files whose path contains this.")] = (
        ""
    )
    selection: Annotated[bool, tyro.conf.arg(help="Fit fields of position too.")] = (
        False
    )


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks recordings")
    if options is None:
        return
    files = recordings(options.folder, options.only)
    options.out.mkdir(parents=True, exist_ok=True)
    print(HEADER)
    rows = []
    for file in files:
        rows.append(timed(file, options))
        print(line(rows[-1]), flush=True)
        table = json.dumps(rows, indent=2) + "\n"
        write_text(options.out / "recordings.json", table, overwrite=True)


def recordings(folder: Path, only: str) -> list[Path]:
    """Files of tracks in a folder and in those that it holds.

    Raises:
        InputError: there are none.
    """
    found = [
        path
        for path in sorted(folder.glob("**/*"))
        if path.name.endswith(ENDINGS) and only in str(path.relative_to(folder))
    ]
    if not found:
        raise InputError(
            f"--folder {folder}: no recordings that match {only!r}; set it, or the "
            "environment variable PINAV_RECORDINGS, to their folder"
        )
    return found


def timed(file: Path, options: Options) -> dict[str, Any]:
    """Seconds of both commands on a file, and the scores of the fit."""
    name = f"{file.parent.name}/{file.name}"
    out = options.out / name.replace("/", "-")
    known = KNOWN.get(file.parent.name, ())
    inspected = _run("inspect", file, out / "inspect", [f"--{word}" for word in known])
    extra = ["--reading", *known] if known else []
    extra += ["--candidates", "all"] if options.selection else []
    fitted = _run("identify", file, out / "fit", extra)
    scores = _scores(out / "fit") if (out / "fit" / "metrics.json").is_file() else {}
    return {"recording": name, "inspect": inspected, "fit": fitted, **scores}


def _run(command: str, file: Path, out: Path, words: Sequence[str]) -> dict[str, Any]:
    program = Path(sys.executable).with_name("pinav")
    call = [str(program), command, str(file), "--out", str(out)]
    begin = time.perf_counter()
    done = subprocess.run(
        [*call, "--overwrite", *words],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | COLD,
    )
    seconds = time.perf_counter() - begin
    reason = done.stderr.strip().splitlines()[-1] if done.returncode else ""
    return {"seconds": seconds, "reason": reason}


def _scores(run: Path) -> dict[str, Any]:
    """Medians over tracks, and coverage over all rollouts."""
    result = RunFolder.open(run).load("metrics", Identification)
    covered = pooled_coverage(result.fitted)
    return {
        "tracks": len(result.fitted),
        "of": len(result.tracks),
        "chosen": _relative(result, "chosen"),
        "least squares": _relative(result, "least squares"),
        "covered": covered if covered == covered else None,
    }


def _relative(result: Identification, name: str) -> float | None:
    """Relative error of rollouts of 10 s."""
    errors = result.summary[name].over(10.0) if name in result.summary else None
    return errors.relative if errors is not None and errors.rollouts else None


HEADER = (
    f"{'':<52}{'inspect [s]':>12}{'fit [s]':>9}{'tracks':>9}{'error':>8}"
    f"{'least sq.':>10}{'in 90 %':>9}\n"
    "error: median over tracks of held-out rollouts of 10 s, end point over path length"
)


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    reason = row["inspect"]["reason"] or row["fit"]["reason"]
    seconds = f"{row['inspect']['seconds']:>12.1f}{row['fit']['seconds']:>9.1f}"
    if reason:
        return f"{row['recording']:<52}{seconds}  {reason}"
    tracks = f"{row['tracks']}/{row['of']}"
    values = (row["chosen"], row["least squares"], row["covered"])
    cells = ["–" if v is None else f"{v:.3f}" for v in values]
    return (
        f"{row['recording']:<52}{seconds}{tracks:>9}{cells[0]:>8}{cells[1]:>10}"
        f"{cells[2]:>9}"
    )
