"""Settings of the documentation: `make docs` builds it, offline, warnings as errors."""

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pinav

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS)]

project, author = "pinav", "The pinav developers"
project_copyright = author
release = pinav.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "command_help",
]
exclude_patterns = ["_build", "examples/README.rst"]
html_theme = "furo"
html_title = "pinav"
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4
default_role = "code"
highlight_language = "none"  # of blocks that name none: what a command prints
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_use_ivar = True
suppress_warnings = ["config.cache"]  # the gallery takes a function


def _figures(block: Any, block_vars: dict[str, Any], settings: dict[str, Any]) -> str:
    """The figures that an example has made since the block before."""
    from sphinx_gallery.scrapers import figure_rst

    del block
    shown = block_vars.setdefault("shown figures", set())
    paths = []
    for name in list(block_vars["example_globals"]):
        value = block_vars["example_globals"][name]
        value = value.figure if isinstance(value, Axes) else value
        if isinstance(value, Figure) and id(value) not in shown:
            shown.add(id(value))
            paths.append(next(block_vars["image_path_iterator"]))
            value.savefig(paths[-1], dpi=120)
    return figure_rst(paths, settings["src_dir"])


sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"(heat|systems)/|rig_client|gymnasium_environment",
    "image_scrapers": (_figures,),
    "write_computation_times": False,
    "abort_on_example_error": True,
}


def _mathml(node: nodes.Element, *, block: bool) -> str:
    return convert(node.astext(), display="block" if block else "inline")


def _visit_math(translator: Any, node: nodes.Element) -> None:
    """Formulas as MathML, which browsers draw without a script or a network."""
    translator.body.append(_mathml(node, block=False))
    raise nodes.SkipNode


def _visit_math_block(translator: Any, node: nodes.Element) -> None:
    translator.body.append(f'<div class="math">{_mathml(node, block=True)}</div>')
    raise nodes.SkipNode


def _math_of_docstrings(
    app: Any, what: Any, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Docstrings write formulas between dollars, as the pages do."""
    del app, what, name, obj, options
    text = "\n".join(lines)
    text = re.sub(r"\$\$(.+?)\$\$", _one_line, text, flags=re.DOTALL)
    text = re.sub(r"(?<!\\)\$([^$]+)\$", _one_line, text)
    # A star begins emphasis, but these begin the names of several axes.
    starred = re.compile(r"^(:vartype .*?: )(.*)$", re.MULTILINE)
    text = starred.sub(lambda m: m[1] + m[2].replace("*", r"\*"), text)
    lines[:] = text.split("\n")


def _one_line(match: re.Match[str]) -> str:
    return f":math:`{' '.join(match[1].split())}`"


def _link_to_source(app: Any, docname: str, source: list[str]) -> None:
    """Links of the pages to files of the repository become names of these files."""
    del app
    root = re.escape("../" * (docname.count("/") + 1))
    outside = rf"\[([^\]]+)\]\((?:{root}[^)]+|[A-Z][A-Za-z.]+)\)"
    source[0] = re.sub(outside, r"`\1`", source[0])


def setup(app: Any) -> None:
    """Register the above."""
    app.add_node(nodes.math, override=True, html=(_visit_math, None))
    app.add_node(nodes.math_block, override=True, html=(_visit_math_block, None))
    app.connect("autodoc-process-docstring", _math_of_docstrings)
    app.connect("source-read", _link_to_source)
