"""Recordings of known truth: what a folder holds, and what is refused."""

import gzip
import json
import re
from pathlib import Path

import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
from validation.truth.__main__ import run
from validation.truth.cases import BUILT_IN, Constants, find_cases, read_recording
from validation.truth.known import brenner_mobility, wall_score
from validation.truth.metrics import Truth, TruthCase, TruthRow
from validation.truth.sections import case_table
from validation.truth.wall import bulk_diffusion, mobility_rows
from validation.truth.wall_fields import WallFields

from pinav.errors import InputError
from pinav.forces import parallel_mobility
from pinav.report import as_text

TRAP = """kind = "trap"
file = "bead.csv"
time = "t_ms"
positions = ["x_nm"]
length_unit = "nm"
time_unit = "ms"
[constants]
temperature_K = 300.0
"""


def trap_folder(folder: Path, frames: int = 1200) -> Path:
    """A folder with the recording of one synthetic trap, and its description."""
    random, decay = np.random.default_rng(0), np.exp(-0.4)
    path = [0.0]
    for kick in 60 * np.sqrt(1 - decay**2) * random.normal(size=frames - 1):
        path.append(decay * path[-1] + kick)
    rows = np.stack([10.0 * np.arange(frames), path], axis=1)
    place = folder / "cases" / "mine"
    place.mkdir(parents=True)
    np.savetxt(place / "bead.csv", rows, delimiter=",", header="t_ms,x_nm", comments="")
    (place / "truth.toml").write_text(TRAP)
    return folder / "cases"


@pytest.mark.slow
def test_a_recording_of_ones_own_is_judged_and_absent_ones_are_said_to_be(
    tmp_path, capsys
):
    out = tmp_path / "run"
    assert run([str(trap_folder(tmp_path)), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "absent: no recording.csv.gz in" in text
    cases = {
        case["name"]: case
        for case in json.loads((out / "metrics.json").read_text())["value"]["cases"]
    }
    assert set(cases) == {*BUILT_IN, "mine"}
    stiffness = cases["mine"]["rows"][0]
    assert stiffness["quantity"] == "stiffness [pN/um]"
    np.testing.assert_allclose(stiffness["truth"], 1.15, rtol=0.2)  # kT / (60 nm)²
    assert stiffness["covered"]
    assert "Verified on recordings" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("x_nm", "y_nm"), "column 'y_nm' is missing; expected some of t_ms, x_nm"),
        (("temperature_K", "temperature"), "unknown field `temperature`"),
        (("kind =", "colour = 1\nkind ="), "unknown field `colour`"),
        (('"trap"', '"spring"'), "Invalid enum value 'spring'"),
        (("temperature_K = 300.0", ""), "constants.temperature_K: this key is missing"),
        (("300.0", "-3"), "constants.temperature_K: expected > 0, got -3"),
        (('time = "t_ms"', ""), "time: name a column, or state rate_Hz"),
        (("file", 'drive = "u"\nfile'), "drive: a dragged trap has it"),
        (('["x_nm"]', '["x_nm", "t_ms"]'), "positions: expected 1 columns for a trap"),
        (('"trap"', '"ring"'), "constants.period: this key is missing"),
        (("kind", "[["), "cannot be read"),
    ],
)
def test_a_description_at_fault_is_refused_in_one_line(tmp_path, change, message):
    folder = trap_folder(tmp_path, frames=30) / "mine"
    text = TRAP.replace(*change)
    (folder / "truth.toml").write_text(text)
    with pytest.raises(InputError, match=re.escape(message)):
        find_cases(folder)[0].read()


def test_a_wall_needs_its_constants(tmp_path):
    folder = trap_folder(tmp_path, frames=30) / "mine"
    text = TRAP.replace('"trap"', '"wall"').replace('["x_nm"]', '["x", "y", "z"]')
    (folder / "truth.toml").write_text(text)
    with pytest.raises(InputError, match="constants: a wall needs radius_um"):
        find_cases(folder)


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a folder of recordings"):
        find_cases(tmp_path / "none")
    with pytest.raises(InputError, match="no recording here; expected folders such as"):
        find_cases(tmp_path)


def test_a_case_that_is_not_there_cannot_be_asked_for(tmp_path, capsys):
    words = [str(trap_folder(tmp_path, frames=30)), "--out", str(tmp_path / "run")]
    assert run([*words, "--only", "hers"]) == 2
    assert "--only: 'hers' is no case; expected some of" in capsys.readouterr().err


def test_compressed_files_and_frame_rates_are_read(tmp_path):
    path = tmp_path / "angles.csv.gz"
    with gzip.open(path, "wt") as file:
        file.write("t_s,angle_00_rad\n0,1\n0.1,2\n")
    description = BUILT_IN["ring_driven_bead"]
    alone = msgspec.structs.replace(
        description, positions=("angle_00_rad",), time="", rate_Hz=20.0
    )
    recording = read_recording(path, alone)
    np.testing.assert_allclose(recording.times, [0.0, 0.05])
    np.testing.assert_allclose(recording.positions, [[1.0], [2.0]])
    with gzip.open(path, "wt") as file:  # as pinav simulate writes it
        file.write('# pinav: {"format": 1}\nt_s,angle_00_rad\n0,1\n0.1,2\n')
    np.testing.assert_allclose(read_recording(path, alone).positions, [[1.0], [2.0]])
    path.write_bytes(b"\x1f\x8bdamaged")
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(path, description)


def test_a_missed_bar_and_a_failed_case_are_published():
    rows = (
        TruthRow(
            quantity="k [pN/um]", learned=1.0, sd=0.01, bar="within 1%", met=False
        ),
    )
    metrics = Truth(
        (
            TruthCase("a", "trap", "judged", seconds=1.0, rows=rows),
            TruthCase("b", "trap", "failed", "diverged"),
        )
    )
    assert metrics.failures == ["b: diverged", "a: k [pN/um]: 1, expected within 1%"]
    text = as_text(case_table(metrics.cases))
    assert "1.000 [0.980, 1.020]" in text


@pytest.mark.slow
def test_diffusion_that_obeys_hydrodynamics_meets_the_bars_of_a_wall():
    gaps = np.linspace(0.1, 1.2, 30)
    along, across = (
        0.14 * np.asarray(mobility(jnp.asarray(gaps)))
        for mobility in (parallel_mobility, brenner_mobility)
    )
    fields = WallFields(
        1.5 * gaps + 8.0, along, 1.2 * across, 0.01 * along, 0.01 * across
    )
    free = [
        wall_score(fields.heights, values, 1.5, normal=normal)
        for values, normal in ((fields.along, False), (fields.across, True))
    ]
    rows = mobility_rows(fields, 1.5, 0.14, free, fields)
    assert [row.met for row in rows] == [True, True, True, False, True]
    assert all(abs(score.contact - 8.0) < 1e-3 for score in free)
    water = Constants(temperature_K=298.15, viscosity_mPa_s=0.89, radius_um=1.0)
    assert bulk_diffusion(water) == pytest.approx(0.245, rel=2e-3)
    assert bulk_diffusion(Constants(diffusion_um2_s=0.2)) == 0.2
    assert bulk_diffusion(Constants(radius_um=1.0)) is None
