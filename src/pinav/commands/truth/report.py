"""Sections of the report of `pinav truth`."""

from pinav.commands.truth.job import curve_file
from pinav.commands.truth.metrics import TruthCase, TruthMetrics, case_table
from pinav.figures import truth_band
from pinav.figures.images import Figures
from pinav.report import Paragraph, Section, capitalise
from pinav.runs import RunFolder


def truth_sections(folder: RunFolder) -> list[Section]:
    """The table of all cases, what failed, and a section with figures for each case."""
    metrics = folder.read_metrics("truth.json", TruthMetrics)
    failures = metrics.failures or ["Every bar is met."]
    judged = [case for case in metrics.cases if case.status == "judged"]
    return [
        Section("Learned, and known by physics", [case_table(metrics.cases)]),
        Section("What failed", [Paragraph(text) for text in failures]),
        *(_case_section(folder, case) for case in judged),
    ]


def _case_section(folder: RunFolder, case: TruthCase) -> Section:
    images, index = [], 0
    while folder.has(curve_file(case.name, index)):
        arrays = folder.read_arrays(curve_file(case.name, index))
        title, x, y = (str(text) for text in arrays["texts"])
        figure = truth_band(
            *(arrays[name] for name in ("places", "learned", "sd")),
            *(arrays[name] for name in ("truth", "truth_sd")),
            labels=(x, y),
        )
        caption = (
            f"{capitalise(title)}. Blue: learned, with its 95 % band; black: the "
            "truth, with twice its standard deviation."
        )
        name = f"truth-{case.name}-{index}"
        images.append(Figures(folder.path).image(name, figure, caption, width=0.6))
        index += 1
    return Section(case.name, [*(Paragraph(note) for note in case.notes), *images])
