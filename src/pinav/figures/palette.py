"""The colours of all figures and of the explorer's page: one colour for one meaning."""

from collections.abc import Mapping

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
"""The colours of Okabe and Ito, which colour-blind readers can tell apart."""

GREY, WALL, PAPER = "#5F5F5F", "#404040", "#FFFFFF"
"""So dark a grey differs from the green for those who do not see green."""

LEARNED, TRUTH, PHYSICS, TRACK = BLUE, BLACK, GREY, VERMILLION
"""What is learned with its band, the truth, known physics alone, what was observed."""

PLAN, NEXT, CUT, TARGET = ORANGE, GREEN, PURPLE, SKY
"""A plan, what to record next, a cut through a map, the outline of a tumour."""

MEANINGS: Mapping[str, str] = {
    "learned": LEARNED,
    "physics": PHYSICS,
    "truth": TRUTH,
    "track": TRACK,
    "cut": CUT,
    "next": NEXT,
    "plan": PLAN,
    "target": TARGET,
    "wall": WALL,
}
"""By the names of the explorer's page."""

HOTTEST, T10, T50, T90 = VERMILLION, SKY, PURPLE, ORANGE
PROBE, OUTSIDE, FIELD, HERE = GREEN, GREY, BLACK, BLUE

HEATING: Mapping[str, str] = {
    "hottest": HOTTEST,
    "T90": T90,
    "D90": T90,
    "probe": PROBE,
    "outside": OUTSIDE,
    "field": FIELD,
    "here": HERE,
    "asRun": GREY,
}
"""Curves of bioheat, by the names of the explorer's page."""

GUIDE, SHADE, BEYOND, FAINT = "#CCCCCC", "#EDEDED", "#D9D9D9", "#B3B3B3"
"""Lines at zero, areas of noise, places without data, sums behind their parts."""

HATCH = "#A0A0A0"

GRADED, UNCERTAIN, WRONG = "viridis", "cividis", "magma"
"""Maps of sizes, of uncertainties and of errors."""

DIVERGING, WARM, FILM, PLAIN = "RdBu_r", "inferno", "gray", "Greys"
"""Maps of signed numbers, of temperatures, of images, and below curves in colours."""
