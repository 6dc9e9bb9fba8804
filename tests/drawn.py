"""Numbers and words of figures, read from their artists without drawing them."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

NUMBERS, WORDS = "drawn.npz", "drawn.txt"


def write_drawn(figures: Iterable[Figure], folder: Path) -> None:
    """Write what figures show into a folder, where there are any."""
    arrays, words = {}, []
    for index, figure in enumerate(figures):
        for place, ax in enumerate(figure.axes):
            for kind, array in numbers_of_axes(ax).items():
                arrays[f"{index}/{place}/{kind}"] = array
            words.append(f"figure {index}: " + "; ".join(words_of_axes(ax)))
    if arrays:
        np.savez(folder / NUMBERS, **arrays)
        (folder / WORDS).write_text("\n".join(words), encoding="utf-8")


def numbers_of_axes(ax: Axes) -> dict[str, np.ndarray]:
    """Limits, and the points of lines, patches, collections and images together."""
    limits = [*ax.get_xlim(), *ax.get_ylim()]
    parts: dict[str, list] = {"limits": [limits]}
    for line in ax.get_lines():
        parts.setdefault("lines", []).append(line.get_xydata())
    for patch in ax.patches:
        path = patch.get_path().transformed(patch.get_patch_transform())
        parts.setdefault("patches", []).append(path.get_extents().extents)
    for artist in (*ax.collections, *ax.images):
        for kind, values in numbers_of_artist(artist):
            parts.setdefault(kind, []).append(np.ma.filled(values, np.nan))
    return {
        kind: np.concatenate([np.ravel(one).astype(float) for one in several])
        for kind, several in parts.items()
    }


def numbers_of_artist(artist: Artist) -> Iterator[tuple[str, np.ndarray]]:
    """Values that are coloured, places and shapes."""
    if artist.get_array() is not None:
        yield "values", artist.get_array()
        yield "colours", np.array(artist.get_clim())
    if hasattr(artist, "get_extent"):
        yield "extents", np.array(artist.get_extent())
        return
    yield "offsets", artist.get_offsets()
    shapes = [path.get_extents().extents for path in artist.get_paths()]
    if shapes:
        yield "shapes", np.stack(shapes)
    if hasattr(artist, "U"):
        yield "arrows", np.stack([artist.U, artist.V])


def words_of_axes(ax: Axes) -> list[str]:
    """Title, labels, kinds of axes, texts, and the entries of the legend."""
    legend = [] if ax.get_legend() is None else ax.get_legend().get_texts()
    texts = [text.get_text() for text in (*ax.texts, *legend)]
    labels = [ax.get_title(loc="left"), ax.get_title(), ax.get_xlabel()]
    scales = [ax.get_xscale(), ax.get_yscale()]
    return [
        word.replace("\n", " ") for word in (*labels, ax.get_ylabel(), *scales, *texts)
    ]
