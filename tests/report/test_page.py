import base64
import re
from html.parser import HTMLParser

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinav.errors import InputError
from pinav.report.page import (
    Code,
    Image,
    Paragraph,
    Section,
    Table,
    capitalise,
    heading,
    measured,
    number,
    percent,
    quantity,
    render,
    sections_text,
)

SVG = '<svg xmlns="http://www.w3.org/2000/svg"><circle r="1"/></svg>'


class Outline(HTMLParser):
    """Every tag with its attributes, the text, and what was left open."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.text, self.open = [], "", []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data

    def names(self):
        return [name for name, _ in self.tags]


def everything(text, path):
    blocks = [
        Paragraph(text),
        Code(text),
        Table([text, "b"], [[f"cell {text}", 1.0]], caption=text),
        Image(path, alt=text, caption=text),
    ]
    return render(text, text, [Section(text, blocks), Section("second", [])])


@pytest.fixture(scope="module")
def svg(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "figure.svg"
    path.write_text(SVG, encoding="utf-8")
    return path


@settings(max_examples=150, deadline=None)
@given(
    text=st.text(min_size=1)
    | st.sampled_from(["</title><script>", '"><img src=x>', "{0}"])
)
def test_text_from_data_never_becomes_markup(svg, text):
    plain, given_page = (Outline(everything(t, svg)) for t in ("plain", text))
    assert given_page.names() == plain.names()
    assert not given_page.open
    attributes = [sorted(attrs) for _, attrs in plain.tags]
    assert [sorted(attrs) for _, attrs in given_page.tags] == attributes


@pytest.mark.parametrize("text", ["<b>&amp;</b>", '"quoted"', "σ ≤ 1 µm", "{braces}"])
def test_text_is_shown_as_written(svg, text):
    outline = Outline(everything(text, svg))
    assert outline.text.count(text) >= 6
    (image,) = [attrs for name, attrs in outline.tags if name == "img"]
    assert image["alt"] == text


def test_page_refers_to_nothing_outside(svg):
    page = everything("plain", svg)
    without_data = re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)
    assert not re.search(r"https?:|//|@import|url\(|file:", without_data)
    for name, attributes in Outline(page).tags:
        assert name not in ("script", "link", "iframe", "object")
        for key in ("src", "href"):
            if key in attributes:
                assert attributes[key].startswith(("data:", "#"))


@pytest.mark.parametrize(
    ("suffix", "media_type"),
    [(".svg", "image/svg+xml"), (".PNG", "image/png"), (".gif", "image/gif")],
)
def test_image_is_embedded_byte_for_byte(tmp_path, suffix, media_type):
    path = tmp_path / f"figure{suffix}"
    path.write_bytes(bytes(range(256)))
    source = re.search(r'src="data:([^;]*);base64,([^"]*)"', Image(path, "a").html())
    assert source is not None
    assert source[1] == media_type
    assert base64.b64decode(source[2]) == path.read_bytes()


def test_contents_lead_to_every_section():
    page = render("t", "s", [Section("One", []), Section("Two", [])])
    tags = Outline(page).tags
    targets = [attrs["id"] for name, attrs in tags if name == "section"]
    links = [attrs["href"] for name, attrs in tags if name == "a"]
    assert links == [f"#{target}" for target in targets]
    assert len(set(targets)) == 2


def test_only_columns_of_numbers_are_flush_right():
    rows = [
        ["ude", 0.015, "1.2 × 10⁻³", None, "100 % (34–100)", "50 (of 100)"],
        ["nn-only", float("inf"), "7 %", 3, "1.025 (1.0–∞)", "7"],
    ]
    header = ["model", "total", "loss", "seed", "success", "share"]
    outline = Outline(Table(header, rows).html())
    cells = [attrs.get("class") for name, attrs in outline.tags if name in ("th", "td")]
    assert cells == [None, "number", "number", "number", "number", None] * 3
    assert "diverged" in outline.text


def test_empty_table_and_page_are_well_formed():
    outline = Outline(render("t", "s", [Section("h", [Table(["a"], [])])]))
    assert not outline.open


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.51219, "2.512"),
        (0.015, "0.01500"),
        (-12.9549, "−12.95"),
        (9999.96, "10000"),
        (58500.0, "58500"),
        (3.9e7, "3.900 × 10⁷"),
        (4.5e-6, "4.500 × 10⁻⁶"),
        (0.0, "0"),
        (501, "501"),
        (-3, "−3"),
        (float("inf"), "diverged"),
        (float("nan"), "–"),
        (None, "–"),
    ],
)
def test_number_keeps_significant_digits(value, text):
    assert number(value) == text


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_number_is_within_half_a_unit_of_its_last_digit(value):
    digits = str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789")
    text = number(value, digits=6).translate(digits).replace(" × 10", "e")
    assert float(text) == pytest.approx(value, rel=5.1e-6)


def test_a_capital_at_the_start_leaves_names_and_units_as_they_are():
    assert capitalise("entropy of k_B. Near data") == "Entropy of k_B. Near data"
    assert capitalise("") == ""


def test_what_is_no_table_or_image_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a .png, .svg or .gif"):
        Image(tmp_path / "figure.jpg", alt="")
    with pytest.raises(InputError, match="cannot be read: No such file"):
        Image(tmp_path / "figure.png", alt="").html()
    with pytest.raises(InputError, match=r"width: expected within \(0, 1\]"):
        Image(tmp_path / "figure.png", alt="", width=0.0)
    with pytest.raises(InputError, match="row 1: expected 2 cells.*got 1"):
        Table(["a", "b"], [[1, 2], [3]])


@pytest.mark.parametrize(("count", "left_out"), [(25, 0), (26, 1)])
def test_a_terminal_shows_the_first_rows_and_counts_the_others(count, left_out):
    table = Table(("name", "value"), [(f"row {i}.", i) for i in range(count)], "All.")
    text = sections_text([Section("Rows", [table])])
    assert "row 24." in text
    assert "row 25." not in text
    assert (f"{left_out} more rows stand in the report. All." in text) == bool(left_out)


def test_a_number_has_the_digits_that_its_deviation_allows():
    assert measured(12.3456, 0.05) == "12.346 ± 0.050 (sd)"
    assert measured(12.3456, None) == "12.3456"
    assert quantity(2.0, "um") == "2.00 um"
    assert quantity(2.0, "1") == "2.00"
    assert heading("error", "um") == "error [um]"
    assert percent(0.25) == 25.0
