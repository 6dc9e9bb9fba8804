"""One colour for one meaning: every colour stands in the palette, and nowhere else."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import pinav
from pinav.figures import palette

ROOT = Path(pinav.__file__).parent
SOURCES = [p for p in sorted(ROOT.rglob("*.py")) if p.name != "palette.py"]
SCRIPTS = [p for p in sorted(ROOT.rglob("*.js")) if p.name != "colours.js"]
COLOURS = ROOT / "commands" / "explore" / "page" / "colours.js"

LITERAL = re.compile(
    r"""["']#[0-9A-Fa-f]{3,8}["']"""
    r"""|\b(?:\w*colors?|fc|ec|mfc|mec|foreground|cmap|c)["']?"""
    r"""\s*[=:]\s*\[?["'](?!none["'])[\w.]+["']"""
)
"""A colour in hexadecimal digits, or by name or grey where a colour is asked for."""


def test_python_names_its_colours():
    literals = {
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in SOURCES
        for match in LITERAL.finditer(path.read_text())
    }
    assert not literals


@pytest.mark.parametrize(
    "text", ['"#E69F00"', 'facecolor="0.5"', "cmap='magma'", '"color": "red"']
)
def test_a_literal_would_be_seen(text):
    assert LITERAL.search(text)


def test_scripts_name_their_colours():
    for path in SCRIPTS:
        literal = re.search(r"#[0-9A-Fa-f]{3,8}\b|rgba?\(", path.read_text())
        assert literal is None, path.name


def table(name):
    text = COLOURS.read_text()
    body = re.search(rf"export const {name} = \{{(.*?)\}};", text, re.DOTALL)[1]
    return dict(re.findall(r'(\w+): "(#\w+)"', body))


def test_the_pages_have_the_colours_of_the_figures():
    assert table("MEANING") == palette.MEANINGS
    assert table("HEATING") == palette.HEATING
    text = (ROOT / "live" / "page.html").read_text()
    colours = set(re.findall(r'"(#[0-9A-Fa-f]{6})', text[text.index("<script") :]))
    assert colours
    assert colours <= set(palette.MEANINGS.values())
    colours = list(palette.MEANINGS.values())
    assert len(set(colours)) == len(colours)


VISION = {
    "normal": np.eye(3),
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
}
"""Machado, Oliveira and Fernandes 2009, at full severity, on linear light."""

LAB = [[0.2126, 0.7152, 0.0722], [0.4124, 0.3576, 0.1805], [0.0193, 0.1192, 0.9505]]
"""Y, X and Z of linear light in sRGB (IEC 61966-2-1)."""


def lab(colour, vision):
    """CIE L*a*b* of a colour as a reader sees it."""
    parts = np.array(to_rgb(colour))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(VISION[vision]) @ linear, 0.0, 1.0)
    y, x, z = np.cbrt(LAB @ seen / np.array([1.0, 0.9505, 1.089]))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("vision", VISION)
def test_what_lies_on_one_map_is_told_apart_by_every_reader(vision):
    """A difference of 2.3 in L*a*b* is just noticeable; here it is seven times that."""
    names = ("learned", "truth", "physics", "track", "plan", "next", "cut")
    places = {name: lab(palette.MEANINGS[name], vision) for name in names}
    for first in names:
        for second in names[: names.index(first)]:
            distance = np.linalg.norm(places[first] - places[second])
            assert distance > 17, (first, second, distance)
