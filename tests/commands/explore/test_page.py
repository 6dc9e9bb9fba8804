"""The page in a real browser: the same numbers as the package, quick, and offline."""

import base64
import json
import math
import re
from pathlib import Path

import jax
import jax.flatten_util
import numpy as np
import pytest
from tests.commands.explore.chromium import Chromium, find_chromium
from tests.commands.test_heat_voxels import write as write_voxels
from tests.heat_cases import small

from pinav import cli
from pinav.commands.explore.document import document
from pinav.commands.explore.job import explorer
from pinav.commands.explore.payload import LEVELS, payload_of
from pinav.commands.explore.printing import pack_array
from pinav.commands.explore.warmth import heat_payload
from pinav.evaluation import square
from pinav.learning.learned import Learned
from pinav.runs import RunFolder
from pinav.thermal.heated_run import HeatedRun

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="no Chromium is installed"),
]

BAR = 1e-3
"""Of the extent of the data."""


@pytest.fixture(scope="module")
def browser():
    browser = Chromium()
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def pages(fitted_runs, tmp_path_factory):
    """A run and the address of its page, by name; each is written once."""
    made = {}

    def page(name):
        if name not in made:
            folder = fitted_runs.copy(name, tmp_path_factory.mktemp(name))[0]
            run = Learned.open(folder)
            content = payload_of(run)
            if name == "kernel":
                content["title"] = '</script><script>alert("title")</script>'
            (folder / "explore.html").write_text(document(content))
            made[name] = run, f"file://{folder}/explore.html"
        return made[name]

    return page


def handle(browser):
    """Where the start is on the screen."""
    corner = browser.run(
        "(({left, top}) => [left, top])"
        "(document.getElementById('paths').getBoundingClientRect())"
    )
    return np.add(browser.run("explorer.handles()[0].at"), corner).tolist()


def opened(browser, address, **size):
    browser.open("about:blank")
    browser.open(address, **size)
    browser.wait_for("globalThis.explorer?.band !== undefined && !explorer.request")


def test_the_plan_leads_to_the_goal_in_the_time_that_it_says(browser, pages, tmp_path):
    """Without forces worth speaking of the time is the distance over the speed."""
    run, _ = pages("langevin")
    content = payload_of(run, straight_plan(run))
    (tmp_path / "plan.html").write_text(document(content))
    opened(browser, f"file://{tmp_path}/plan.html")
    browser.wait_for("explorer.ground !== null")
    plan = content["plan"]
    said = browser.run("explorer.experiment.plan.timeFrom(explorer.experiment.start())")
    distance = math.dist(plan["start"], plan["goal"])
    assert said == pytest.approx(distance / SPEED, rel=0.02)
    arrival = browser.run("explorer.route.arrival")
    assert arrival == pytest.approx((distance - plan["tolerance"]) / SPEED, rel=0.1)
    assert "The plan reaches the goal" in browser.run("readout.textContent")


SPEED = 50.0
"""So great a thrust that learned forces hardly matter."""


def straight_plan(run):
    x0, x1, y0, y1 = map(float, square(run.data))
    axes = np.linspace(x0, x1, 41), np.linspace(y0, y1, 41)
    goal = [0.8 * x1 + 0.2 * x0, 0.8 * y1 + 0.2 * y0]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    times = np.linalg.norm(places - goal, axis=-1) / SPEED
    angles = 2 * np.pi * np.arange(24) / 24
    step = 0.02 * (x1 - x0) / SPEED
    mobility = float(run.model.mobility.value)
    thrusts = SPEED / mobility * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    scale = float(times.max())
    return {
        "arena": [[x0, y0], [x1, y1]],
        "start": [0.8 * x0 + 0.2 * x1, 0.7 * y0 + 0.3 * y1],
        "goal": goal,
        "tolerance": 0.03 * (x1 - x0),
        "discs": [],
        "step": step,
        "lower": [x0, y0],
        "spacing": [float(axis[1] - axis[0]) for axis in axes],
        "scale": scale,
        "ahead": 2 * step,
        "horizon": 2 * scale,
        "thrusts": thrusts.tolist(),
        "values": pack_array(np.round(np.exp(-times / scale) * LEVELS), "u2"),
    }


@pytest.fixture(scope="module")
def heated(tmp_path_factory):
    """A tumour of 24 cells, heated: the folder of its run, and its page."""
    folder = tmp_path_factory.mktemp("heat")
    case = small("tumour", folder, {"step": 5.0})
    out = folder / "run"
    with jax.numpy_dtype_promotion("standard"):
        assert cli.run(["heat", "simulate", str(case), "--out", str(out)]) == 0
    return out, document(heat_payload(RunFolder.open(out)))


def test_a_run_of_bioheat_is_that_of_the_package(browser, heated, tmp_path):
    folder, page = heated
    (tmp_path / "heat.html").write_text(page)
    browser.open(f"file://{tmp_path}/heat.html", width=360)
    browser.wait_for("globalThis.explorer?.result !== undefined")
    result = RunFolder.open(folder).load("metrics", HeatedRun)
    for name in ("hottest", "T90", "D90"):
        times, values = np.array(browser.run(f"explorer.series('{name}')")).T
        saved = (result.doses if name == "D90" else result.temperatures)[name]
        error = np.interp(result.times, times, values) - saved
        assert np.abs(error).max() < 3 * BAR * np.ptp(saved), name
    assert browser.run("document.documentElement.scrollWidth") <= 360
    before = browser.run("explorer.series('hottest').at(-1)[1]")
    browser.run("document.querySelector('#panel input[type=number]').focus()")
    browser.run("document.activeElement.select()")
    browser.send("Input.insertText", text="5")
    browser.press("Tab")
    browser.wait_for("!explorer.request && explorer.conditions.starts[0] === 5000")
    assert browser.run("explorer.series('hottest').at(-1)[1]") < before - 1
    assert browser.run("explorer.elapsed") < 1000
    assert "starts=5000" in browser.run("location.hash")
    browser.check_quiet()


@pytest.fixture(scope="module")
def boxed(tmp_path_factory):
    """A block of voxels, heated and cooling: the folder of its run, and its page."""
    folder = tmp_path_factory.mktemp("box")
    field = {"field.times": [0, 60, 90], "field.amplitudes": [1e4, 0.0]}
    case = write_voxels(folder, {**field, "probes": {"points": [[5e-3, 5e-3, 6e-3]]}})
    out = folder / "run"
    with jax.numpy_dtype_promotion("standard"):
        assert cli.run(["heat", "simulate", str(case), "--out", str(out)]) == 0
        assert cli.run(["explore", str(out)]) == 0
    return out


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_a_run_of_bioheat_in_a_box_is_read_as_it_was_run(plane, browser, boxed):
    address = f"file://{boxed}/explore.html#plane={plane}&x=5&y=5"
    browser.open("about:blank")
    browser.open(address, width=360)
    browser.wait_for("globalThis.explorer?.elapsed !== undefined")
    result = RunFolder.open(boxed).load("metrics", HeatedRun)
    section = browser.run("explorer.section.normal")
    (saved,) = (p.temperatures for p in result.planes if "xyz"[p.cut.axis] == section)
    page = browser.run("[...explorer.section.temperature]")
    sides = np.array(browser.run("explorer.section.box"))[1::2]
    cell = tuple((5 / sides * saved.shape[1:]).astype(int))
    np.testing.assert_allclose(page, saved.reshape(-1), atol=1e-4)
    for time in (result.moments[7], 41.3):
        browser.run(f"explorer.change({{ time: {time} }})")
        browser.wait_for("!explorer.request")
        there = np.interp(time, result.moments, saved[:, *cell])
        assert browser.run("explorer.reading()") == pytest.approx(there, abs=1e-3)
    browser.run("document.getElementById('paths').focus()")
    browser.press("ArrowRight")
    browser.press("ArrowRight", modifiers=8)
    browser.run("explorer.change({ quantity: 'dose' })")
    browser.wait_for("!explorer.request")
    assert browser.run("explorer.conditions.x") > 5
    assert "quantity=dose" in browser.run("location.hash")
    assert "CEM43" in browser.run("document.getElementById('unit').textContent")
    assert browser.run("explorer.table().split('\\n').length") == 2 + len(result.times)
    assert browser.run("document.documentElement.scrollWidth") <= 360
    assert browser.run("explorer.elapsed") < 1000 / 10
    browser.check_quiet()


MODEL = """
globalThis.model = {
  state: PARTS,
  listeners: [],
  get(name) { return this.state[name]; },
  set(name, value) { this.state[name] = value; this.listeners.forEach((f) => f()); },
  save_changes() { this.saved = { ...this.state }; },
  on(event, listener) { this.listeners.push(listener); },
  off() { this.listeners = []; },
};
"""
"""What anywidget gives the module of a widget: shared state, and its changes."""


@pytest.mark.extras("anywidget")
def test_a_widget_shares_its_conditions_with_the_notebook(browser, pages):
    run, _ = pages("kernel")
    widget = explorer(run.folder.path).widget()
    parts = {name: getattr(widget, name) for name in ("page", "height", "address")}
    assert widget.get_state()["page"] == parts["page"]
    browser.open("about:blank")
    browser.run(MODEL.replace("PARTS", json.dumps(parts)) + "0")
    module = base64.b64encode(widget._esm.encode()).decode()
    browser.run(
        f"import('data:text/javascript;base64,{module}').then("
        "(m) => void (globalThis.end = m.default.render({ model, el: document.body })))"
    )
    browser.wait_for("model.saved?.path")
    assert browser.run("model.saved.path").startswith("t,x,y,vx,vy,sd x,sd y\n")
    browser.run("void (globalThis.page = document.querySelector('iframe'))")
    browser.run("page.contentWindow.explorer.change({ x: 3.25 })")
    browser.wait_for("model.saved.address === 'x=3.25'")
    browser.run("model.set('address', 'x=4.5&y=2')")
    browser.wait_for("model.saved.path.split(/[,\\n]/)[8] === '4.5'")
    assert browser.run("model.saved.address") == "x=4.5&y=2"
    browser.run("end()")
    assert browser.run("model.listeners.length") == 0
    assert not browser.named("Runtime.exceptionThrown")


def test_the_frame_of_a_notebook_keeps_its_own_address(browser, pages):
    run, _ = pages("kernel")
    frame = explorer(run.folder.path)._repr_html_()
    browser.open("about:blank")
    browser.run(f"void (document.body.innerHTML = {json.dumps(frame)})")
    browser.wait_for("document.querySelector('iframe').contentWindow.explorer?.band")
    browser.run(
        "void (globalThis.page = document.querySelector('iframe').contentWindow)"
    )
    browser.run("page.explorer.change({ x: 3.25 })")
    browser.wait_for("page.location.hash === '#x=3.25'")
    assert browser.run("location.hash") == ""
    assert not browser.named("Runtime.exceptionThrown")


def test_nothing_leaves_the_page_and_nothing_complains(browser, pages):
    opened(browser, f"{pages('kernel')[1]}#show=band,physics,truth,draws,tracks,arrows")
    browser.run("document.querySelectorAll('#panel button').forEach((b) => b.click())")
    browser.wait_for("!explorer.request && !explorer.suggesting", 60)
    schemes = {
        event["request"]["url"].partition(":")[0]
        for event in browser.named("Network.requestWillBeSent")
    }
    assert schemes <= {"file", "data", "blob"}
    browser.check_quiet("Runtime.consoleAPICalled", "Page.javascriptDialogOpening")
    assert browser.run("document.querySelector('h1').textContent").startswith(
        "</script>"
    )
    refused = browser.run("fetch('https://example.org').then(() => 'sent', () => 'no')")
    assert refused == "no"


def test_dragging_is_quick_and_the_band_follows(browser, pages):
    """The least of several times is the page's, whatever else the machine does."""
    _, address = pages("kernel")
    opened(browser, address)
    x, y = handle(browser)
    browser.mouse("Pressed", x, y)
    for step in range(30):
        browser.mouse("Moved", x + 2 * step, y + step)
    browser.mouse("Released", x + 58, y + 29)
    for _ in range(5):
        browser.wait_for("!explorer.request")
        browser.run("explorer.change({})")
    browser.wait_for("!explorer.request && explorer.band !== null")
    frame = browser.run("explorer.timings.frame")
    assert len(frame) > 3
    assert min(frame) < 1000 / 60
    assert min(browser.run("explorer.timings.band")) < 100
    start = browser.run("[explorer.conditions.x, explorer.conditions.y]")
    placed = browser.run(
        "((f) => f.place(...explorer.handles()[0].at))(explorer.mapFrame)"
    )
    np.testing.assert_allclose(start, placed)


def test_a_finger_drags_the_start(browser, pages):
    opened(browser, pages("kernel")[1], width=360)
    browser.send("Emulation.setTouchEmulationEnabled", enabled=True)
    x, y = handle(browser)
    for kind, points in (
        ("touchStart", [{"x": x, "y": y}]),
        ("touchMove", [{"x": x - 40, "y": y + 20}]),
        ("touchEnd", []),
    ):
        browser.send("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    browser.send("Emulation.setTouchEmulationEnabled", enabled=False)
    browser.wait_for("!explorer.request")
    np.testing.assert_allclose(handle(browser), [x - 40, y + 20], atol=1)
    assert browser.run("window.scrollY") == 0


def test_the_address_holds_what_is_seen(browser, pages):
    _, address = pages("kernel")
    opened(browser, address)
    browser.run(
        "explorer.change({ x: 3.25, vy: -0.5, cut: [1, 2, 3, 4], turn: Math.PI / 2 })"
    )
    browser.wait_for("!explorer.request")
    shared = browser.run("location.href")
    assert "x=3.25" in shared
    opened(browser, shared)
    state = browser.run("explorer.conditions")
    assert (state["x"], state["vy"], state["cut"]) == (3.25, -0.5, [1, 2, 3, 4])
    assert math.isclose(state["turn"], math.pi / 2, rel_tol=1e-5)


@pytest.mark.parametrize(
    "text", ["#x=NaN&k=99&m=-3&T=-1", "#show=%3Cb%3E&cut=1,2&q=no"]
)
def test_an_address_that_makes_no_sense_is_as_none(text, browser, pages):
    opened(browser, pages("kernel")[1] + text)
    assert not browser.named("Runtime.exceptionThrown")
    assert browser.run("Number.isFinite(explorer.mean.states.at(-1)[0])")


def test_the_keyboard_alone_does_it(browser, pages):
    opened(browser, pages("kernel")[1])
    seen = set()
    for _ in range(40):
        browser.press("Tab")
        element = "document.activeElement"
        seen.add(browser.run(f"{element}.id || {element}.textContent"))
        if browser.run("document.activeElement.id") == "paths":
            x, vx = browser.run("[explorer.conditions.x, explorer.conditions.vx]")
            browser.press("ArrowRight")
            browser.press("ArrowUp", modifiers=8)
    assert {"paths", "Draw a cut", "Picture", "Path as CSV", "next"} <= seen
    assert browser.run("explorer.conditions.x") > x
    assert browser.run("explorer.conditions.vx") == pytest.approx(vx)
    assert browser.run(
        "[...document.querySelectorAll('input, select')].every("
        "(e) => e.labels.length || e.getAttribute('aria-label'))"
    )


def test_a_report_is_no_wider_than_a_narrow_page(browser, fitted_runs, tmp_path):
    """Tables scroll below it; the page does not."""
    folder = fitted_runs.copy("kernel", tmp_path / "kernel")[0]
    browser.open(f"file://{folder}/report.html", width=400)
    assert browser.run("document.documentElement.scrollWidth") <= 400
    assert browser.run(
        "[...document.querySelectorAll('.wide, figure, pre, p')].every("
        "(e) => e.getBoundingClientRect().right <= 400)"
    )


@pytest.mark.parametrize("width", [360, 768, 1400])
def test_nothing_is_wider_than_the_page(width, browser, pages):
    opened(browser, f"{pages('kernel')[1]}#cut=0,0,5,5", width=width)
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run("document.getElementById('paths').clientWidth") > 0.5 * min(
        width, 700
    )


def test_the_table_of_the_path_has_its_units_and_numbers(browser, pages):
    run, address = pages("identified")
    opened(browser, address, width=400)
    lines = browser.run("explorer.table()").split("\n")
    assert lines[0] == "t [s],x [um],y [um],sd x [um],sd y [um]"
    assert all(re.fullmatch(r"[-\d.e+]+(,[-\d.e+]+){4}", row) for row in lines[1:-1])
    assert browser.run("explorer.run.tracks.length") == len(run.data)
    track = browser.run("[...explorer.experiment.tracks[0].x]")
    seen = run.data.states[0, :, 0][run.data.observed[0, :, 0]]
    np.testing.assert_allclose(track, seen[:: len(seen) // len(track)], rtol=1e-5)
    assert "µm" in browser.run("document.getElementById('panel').textContent")


SLIDE = """((label, value) => {
  const slide = document.querySelector(`input[type=range][aria-label^="${label}"]`);
  slide.value = value ?? slide.max;
  for (const kind of ["input", "change"]) slide.dispatchEvent(new Event(kind));
  return Number(slide.value);
})"""
"""Drag a slider, by the beginning of its name, to a value or to its end."""


def test_every_slider_does_what_it_says(browser, pages):
    """From the replay of recorded commands on."""

    def end(change):
        value = browser.run(change)
        browser.wait_for("!explorer.request")
        return value, np.array(browser.run("[...explorer.mean.states.at(-1)]"))

    opened(browser, pages("identified")[1])
    end("explorer.goToTrack(0)")
    assert browser.run("explorer.conditions.replay")
    before = browser.run("explorer.conditions.frequency")
    hertz, faster = end(f"{SLIDE}('frequency', {before} + 1)")
    assert browser.run("explorer.conditions.frequency") == pytest.approx(hertz)
    assert not browser.run("explorer.conditions.replay")
    _, turned = end(f"{SLIDE}('heading', 90)")
    assert np.isfinite(turned).all()
    assert np.linalg.norm(turned - faster) > 0
    end("void explorer.change({ show: ['band', 'tracks'] })")
    narrow = browser.run("explorer.band.sd.at(-1)[0]")
    end(f"{SLIDE}('noise')")
    assert browser.run("explorer.band.sd.at(-1)[0]") > narrow
    assert "s=" in browser.run("location.hash")
    browser.check_quiet()


def test_numbers_that_are_damaged_are_said_to_be(browser, pages, tmp_path):
    _, address = pages("kernel")
    text = Path(address.removeprefix("file://")).read_text()
    (tmp_path / "page.html").write_text(text.replace('"models":', '"models": oh '))
    browser.open(f"file://{tmp_path}/page.html")
    message = browser.run("document.getElementById('failure').textContent")
    assert "write it again with pinav explore" in message
