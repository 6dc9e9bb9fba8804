"""The explorer's page: one HTML file of a template, styles, modules and numbers.

The modules are plain ES modules in `page/`. They are written one after the other,
without their import lines, into one module script: a file that is opened from a disk
may not import others, and the content security policy allows this script alone, by its
hash.
"""

import base64
import hashlib
import html
import re
from importlib.resources import files

import msgspec

from pinav.commands.explore.printing import Tree
from pinav.errors import InputError
from pinav.report import Link, Paragraph, Section
from pinav.runs import RunFolder

PAGE = "explore.html"
"""Name of the page in its run."""

MODULES = (
    *("numbers", "model", "rollout", "plan", "colours", "quantities", "view"),
    *("experiment", "session", "panel", "gestures", "sharing", "tissue", "oven"),
    *("sections", "main"),
)
"""The modules, each after those that it imports; `PROGRAMS` stands after the first."""

NO_PROGRAMS = "const PROGRAMS = [];"
"""The functions of a run without a model."""

MAX_BYTES = 1_500_000
"""Size of a page that a browser opens at once and people send by mail."""

_IMPORT = re.compile(r"^import .*?;\n", re.MULTILINE | re.DOTALL)
_EXPORT = re.compile(r"^export (?=const|function|class|async)", re.MULTILINE)


def document(payload: Tree) -> str:
    """The page of a run.

    Args:
        payload: what it knows of the run; its "programs" are the text of the functions
            that were printed for it.

    Raises:
        InputError: the page would be too large.
    """
    style, script = source("page.css"), bundle(payload.get("programs", NO_PROGRAMS))
    page = source("page.html").format(
        policy=policy(script, style),
        title=html.escape(payload["title"]),
        style=style,
        script=script,
        payload=script_json({k: v for k, v in payload.items() if k != "programs"}),
    )
    size = len(page.encode())
    if size > MAX_BYTES:
        raise InputError(
            f"explore: the page of this run would have {size / 1e6:.1f} MB, more than "
            f"{MAX_BYTES / 1e6} MB; fit fewer kernels or a smaller network"
        )
    return page


def explorer_sections(folder: RunFolder) -> list[Section]:
    """The section of a report that leads to the page, where there is one."""
    if not folder.has(PAGE):
        return []
    words = "In this page the model itself runs: change the conditions, see the effect."
    return [Section("Explorer", [Paragraph(words), Link(PAGE, "Explore the model")])]


def bundle(programs: str = NO_PROGRAMS) -> str:
    """All modules and the functions of a run as the text of one module script."""
    first, *rest = (
        _EXPORT.sub("", _IMPORT.sub("", source(f"{n}.js"))) for n in MODULES
    )
    return "\n" + "\n".join([first, programs, *rest])


def script_json(payload: Tree) -> str:
    """JSON that may stand in a script element: no text in it can end the element."""
    text = msgspec.json.encode(payload).decode()
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def policy(script: str, style: str) -> str:
    """A content security policy: this script, these styles, and no request at all."""
    return (
        f"default-src 'none'; script-src '{_hash(script)}'; "
        f"style-src '{_hash(style)}'; img-src data: blob:; base-uri 'none'; "
        "form-action 'none'"
    )


def source(name: str) -> str:
    """A file of the page."""
    folder = files("pinav.commands.explore").joinpath("page")
    return folder.joinpath(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
