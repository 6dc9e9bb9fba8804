"""The page's file: what is in it, what may not be, and what is refused."""

import base64
import dataclasses
import hashlib
import html
import json
import re
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.samples import sample

import pinav.commands.explore
from pinav.commands.explore import document, payload
from pinav.commands.explore.job import explorer
from pinav.commands.explore.payload import plan_of
from pinav.commands.explore.printing import pack_array
from pinav.commands.explore.warmth import heat_payload
from pinav.errors import InputError
from pinav.forces import AbstractForce, ZeroForce
from pinav.learning.learned import Learned
from pinav.runs import RunFolder
from pinav.thermal.heated_run import FOLLOWED, HeatedRun, Plane, cuts_through
from pinav.thermal.protocols import Piecewise

PAGE = Path(pinav.commands.explore.__file__).parent / "page"
SOURCES = {path.stem: path.read_text() for path in sorted(PAGE.glob("*.js"))}


@pytest.fixture(scope="module")
def run(fitted_runs, tmp_path_factory):
    return fitted_runs.copy("kernel", tmp_path_factory.mktemp("run"))[0]


@pytest.fixture(scope="module")
def content(run):
    return payload.payload_of(Learned.open(run))


@given(st.text())
def test_no_text_of_a_run_can_end_the_element_that_holds_it(text):
    held = document.script_json({"title": text})
    assert not set("<>&\u2028\u2029") & set(held)
    assert json.loads(held) == {"title": text}


def test_a_title_with_markup_is_shown_and_not_obeyed(content):
    title = '</script><script>alert(1)</script>" onload="x'
    page = document.document({**content, "title": title})
    assert page.count("<script") == 2
    assert f"<title>{html.escape(title)}</title>" in page


def test_the_policy_allows_this_script_and_no_request(content):
    page = document.document(content)
    script = re.search(r'<script type="module">(.*)</script>', page, re.DOTALL)
    digest = hashlib.sha256(script[1].encode()).digest()
    allowed = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert allowed.startswith("default-src 'none'; ")
    assert f"script-src 'sha256-{base64.b64encode(digest).decode()}'" in allowed
    assert "unsafe" not in allowed
    assert "http:" not in page
    assert "https:" not in page


def test_modules_are_joined_after_those_that_they_import():
    assert sorted(document.MODULES) == sorted(SOURCES)
    for index, name in enumerate(document.MODULES):
        imports = re.findall(r'from "\./(\w+)\.js"', SOURCES[name])
        assert set(imports) <= set(document.MODULES[:index]), name


def test_modules_that_are_joined_share_no_name():
    declared = re.findall(
        r"^(?:const|let|class|function\*?|async function) (\w+)",
        document.bundle(),
        re.MULTILINE,
    )
    assert sorted(declared) == sorted(set(declared))
    assert not re.search(r"^(import|export) ", document.bundle(), re.MULTILINE)


class StrangeForce(AbstractForce):
    """A force with an operation that no rule prints."""

    def __call__(self, t, x, v):
        return jnp.sort(x) * jnp.exp(-0.02 * jnp.sum(x**2))


def payload_with(fitted, model):
    """The payload of a fit with another model."""
    models = {"model": model}
    return payload.payload_of(dataclasses.replace(fitted, models=models, evidence=None))


def test_a_force_that_is_not_printed_is_shown_from_a_table_a_propulsion_refused(run):
    fitted = Learned.open(run)
    held = payload_with(fitted, fitted.model.with_environment(StrangeForce()))
    assert 0 < held["models"][0]["tableError"] < 0.1
    assert len(document.document(held)) < document.MAX_BYTES
    strange = dataclasses.replace(fitted.model, propulsion=StrangeForce())
    with pytest.raises(InputError, match="has the operation 'sort' of JAX"):
        payload_with(fitted, strange)


def test_packed_numbers_are_those_of_the_array():
    array = np.arange(6.0).reshape(2, 3) / 7
    held = pack_array(array, "f8")
    decoded = np.frombuffer(base64.b64decode(held["f8"]), "<f8").reshape(held["shape"])
    np.testing.assert_array_equal(decoded, array)


def test_a_factor_of_few_directions_keeps_the_field(run):
    fit = Learned.open(run)
    factor, kept = payload.directions(fit.posterior, (0.0, 10.0, 0.0, 10.0))
    assert factor.shape[1] < len(fit.posterior.mean)
    assert kept > 0.9999
    points = np.random.default_rng(0).uniform(0, 10, (20, 2))
    rows = fit.posterior.force_jacobians(points)
    sd = np.sqrt(np.einsum("pdi,ik,pdk->pd", rows, factor @ factor.T, rows))
    # a page draws weights, which know nothing of unvisited ground
    of_weights = dataclasses.replace(fit.posterior, visited=None)
    np.testing.assert_allclose(sd, of_weights.force_sd(points), rtol=0.01)


def test_a_factor_has_no_more_numbers_than_a_page_may_hold(run, monkeypatch):
    fit = Learned.open(run)
    monkeypatch.setattr(payload, "NUMBERS", 3 * len(fit.posterior.mean))
    factor, kept = payload.directions(fit.posterior, (0.0, 10.0, 0.0, 10.0))
    assert factor.shape == (len(fit.posterior.mean), 3)
    assert kept < 1


def test_a_page_that_would_be_huge_is_refused(content, monkeypatch):
    monkeypatch.setattr(document, "MAX_BYTES", 1000)
    with pytest.raises(InputError, match=r"would have \d\.\d MB, more than"):
        document.document(content)


def test_a_run_that_is_no_plane_is_refused(run, monkeypatch):
    fit = Learned.open(run)
    monkeypatch.setattr(type(fit.data), "dim", property(lambda self: 1))
    with pytest.raises(InputError, match="explore draws a plane, got the coordinates"):
        payload.payload_of(fit)


@pytest.mark.slow
def test_the_command_writes_the_page_and_links_to_it(fitted_run, printed):
    folder, _ = fitted_run("kernel")
    assert "explorer: " in printed("explore", folder)
    assert (folder / "explore.html").stat().st_size < document.MAX_BYTES
    assert 'href="explore.html"' in (folder / "report.html").read_text()
    assert "explore.html" in json.loads((folder / "manifest.json").read_text())


def test_a_plan_without_its_fit_or_its_result_is_refused(tmp_path, run, refused):
    planned = {"run": {"fitted": "absent"}}
    folder = RunFolder.create(tmp_path / "there", planned, overwrite=False)
    refused(["explore", folder.path], "'absent' that it was planned with beside it")
    refused(["explore", run, "--fit", run], "--fit: ")
    with pytest.raises(InputError, match=r"metrics.json is missing"):
        plan_of(folder)


def boxed(folder, shape, moments):
    """A run in a box, or on a plane, that cools from its middle."""
    places = np.indices(shape) - (np.array(shape) // 2).reshape(-1, *[1] * len(shape))
    target = (np.sqrt((places**2).sum(axis=0)) < min(shape) / 5).astype(float)
    times = np.linspace(1.0, 600.0, moments)
    hot = 37 + 8 * np.exp(-((places / min(shape)) ** 2).sum(axis=0) * 8)
    warm = np.exp(-times / 300.0)
    kept = np.linspace(0, moments - 1, min(moments, 61)).round().astype(int)

    def plane(cut):
        cooling = (np.asarray(cut.of(jnp.asarray(hot))) - 37) * warm[kept, None, None]
        return Plane(cut, (37 + cooling).astype("f4"))

    curve = 37 + 8 * warm
    run = sample(
        HeatedRun,
        title="a box",
        protocol=Piecewise.constant((0.0, 600.0), [1e4], 1e5),
        times=times,
        temperatures=dict.fromkeys(FOLLOWED, curve),
        above=curve / 100,
        doses=dict.fromkeys(("D90", "outside"), np.cumsum(curve)),
        target=target,
        temperature=37 + (hot - 37) * warm[-1],
        dose=hot - 36.99,
        points=np.zeros((1, len(shape))),
        probes=curve[:, None],
        spacing=(1e-3,) * len(shape),
        moments=times[kept],
        planes=tuple(map(plane, cuts_through(target))),
    )
    made = RunFolder.create(folder, {"run": {"command": "heat"}}, overwrite=False)
    made.write_arrays("results.npz", {"temperature": run.temperature})
    made.store("metrics", run)
    return folder


def test_a_large_box_of_bioheat_keeps_the_size_of_a_page(tmp_path):
    folder = boxed(tmp_path / "heat", (70, 200, 64), 181)
    content = heat_payload(RunFolder.open(folder))
    shapes = [s["temperature"]["shape"] for s in content["sections"]]
    assert [s["normal"] for s in content["sections"]] == ["z", "y", "x"]
    assert [shape[1:] for shape in shapes] == [[35, 100], [70, 64], [100, 32]]
    assert content["moments"]["shape"] == [26]
    assert len(document.document(content)) < document.MAX_BYTES


def test_a_notebook_shows_the_page_in_a_frame(run):
    """It need not ask for float64."""
    shown = explorer(run)._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert shown.count("<") == 2  # everything of the page is escaped
    with jax.enable_x64(new_val=False):
        page = explorer(run).page
    assert f'srcdoc="{html.escape(page)}"' in shown
    assert "explore.html" not in {path.name for path in run.iterdir()}


def test_a_widget_without_its_package_is_refused(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(InputError, match=r"pip install 'pinav\[notebook\]'"):
        explorer(run).widget()


def test_the_map_holds_the_arena_of_a_plan(content):
    box = payload._union((0.0, 4.0, 0.0, 4.0), [[1.0, 1.0], [10.0, 3.0]])
    assert box == (0.0, 10.0, -3.0, 7.0)
    assert content["plan"] is None


def test_without_an_environment_the_title_is_the_system_alone(run, content):
    fitted = Learned.open(run)
    assert content["title"] == f"{fitted.system.name}: kernel-potential"
    bare = payload_with(fitted, fitted.model.with_environment(ZeroForce()))
    assert bare["title"] == fitted.system.name
