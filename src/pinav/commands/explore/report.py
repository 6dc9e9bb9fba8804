"""The section of a report that leads to the explorer's page."""

from pinav.report import Link, Paragraph, Section
from pinav.runs import RunFolder


def explorer_sections(folder: RunFolder) -> list[Section]:
    """A link to the page, where there is one."""
    if not folder.has("explore.html"):
        return []
    words = "In this page the model itself runs: change the conditions, see the effect."
    link = Link("explore.html", "Explore the model")
    return [Section("Explorer", [Paragraph(words), link])]
