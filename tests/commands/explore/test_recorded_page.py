"""The page of a real recording: its units, tracks, commands, and every slider."""

import gzip

import jax
import numpy as np
import pytest
from tests.commands.explore.chromium import Chromium, find_chromium
from tests.fitted_runs import cheap_residual_fields

from pinav import cli
from pinav.dynamics import drive_by_commands, rollout
from pinav.learning.learned import Learned

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="no Chromium is installed"),
]

ROWS = 600
"""Frames of the recording that are identified."""

SLIDE = """((label, value) => {
  const slide = document.querySelector(`input[type=range][aria-label^="${label}"]`);
  slide.value = value;
  for (const kind of ["input", "change"]) slide.dispatchEvent(new Event(kind));
  return Number(slide.value);
})"""
"""Drag a slider, by the beginning of its name, to a value and let it go."""


@pytest.fixture(scope="module")
def recorded(recording, tmp_path_factory):
    """Half a minute of a rolling robot, identified, and its page: the run's folder."""
    source = recording("magscope_roller_circles/control_circles.csv.gz")
    header, *rows = gzip.decompress(source.read_bytes()).decode().splitlines()
    frequency = header.split(",").index("freq_hz")
    driven = [row for row in rows if float(row.split(",")[frequency]) > 0][:ROWS]
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "robot.csv").write_text("\n".join([header, *driven, ""]))
    out = folder / "run"
    with cheap_residual_fields(), jax.numpy_dtype_promotion("standard"):
        words = ["identify", str(folder / "robot.csv"), "--out", str(out)]
        assert cli.run(words) == 0
        assert cli.run(["explore", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def page(recorded):
    """A browser that has opened the page."""
    browser = Chromium()
    browser.open(f"file://{recorded}/explore.html", width=400)
    browser.wait_for("globalThis.explorer?.band !== undefined && !explorer.request")
    yield browser
    browser.close()


def end(page):
    page.wait_for("!explorer.request")
    return np.array(page.run("[...explorer.mean.states.at(-1)]"))


def test_it_shows_the_recording_in_its_units(page, recorded):
    run = Learned.open(recorded)
    assert page.run("explorer.run.units.x") == "um"
    assert page.run("explorer.run.tracks.length") == len(run.data)
    track = page.run("[...explorer.experiment.tracks[0].x]")
    seen = run.data.states[0, :, 0][run.data.observed[0, :, 0]]
    np.testing.assert_allclose(track, seen[:: len(seen) // len(track)], rtol=1e-5)
    assert "µm" in page.run("document.getElementById('panel').textContent")
    assert page.run("document.documentElement.scrollWidth") <= 400


def test_recorded_commands_move_it_as_in_the_package(page, recorded):
    page.run("explorer.goToTrack(0)")
    end(page)
    assert page.run("explorer.conditions.replay")
    run = Learned.open(recorded)
    piece = next(iter(run.data))
    first = run.models[page.run("explorer.run.models[0].name")]
    times = np.array(page.run("[...explorer.times]"))
    start = np.array(page.run("explorer.experiment.start()"))
    path = rollout(drive_by_commands(first, piece), start, times)
    states = np.array(page.run("explorer.mean.states.map((y) => [...y])"))
    extent = page.run("explorer.run.extent")
    assert np.abs(states - np.asarray(path.ys)).max() < 1e-3 * extent


def test_every_slider_does_what_it_says(page):
    page.run("explorer.goToTrack(0)")
    end(page)
    before = page.run("explorer.conditions.frequency")
    hertz = page.run(f"{SLIDE}('frequency', {before} + 1)")
    faster = end(page)
    assert page.run("explorer.conditions.frequency") == pytest.approx(hertz)
    assert not page.run("explorer.conditions.replay")
    page.run(f"{SLIDE}('heading', 90)")
    turned = end(page)
    assert np.linalg.norm(turned - faster) > 0
    start = np.array(page.run("explorer.experiment.start()"))
    assert np.isfinite(turned - start).all()
    page.run("explorer.change({ show: ['band', 'tracks'] })")
    end(page)
    narrow = page.run("explorer.band.sd.at(-1)[0]")
    noise = page.run(
        """Number(document.querySelector('input[type=range][aria-label^="noise"]').max)"""
    )
    page.run(f"{SLIDE}('noise', {noise})")
    end(page)
    assert page.run("explorer.band.sd.at(-1)[0]") > narrow
    assert "s=" in page.run("location.hash")
    page.check_quiet()
