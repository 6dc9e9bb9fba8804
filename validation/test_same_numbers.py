"""The comparison of two versions finds what moved, and lists what changed."""

import json

import numpy as np
from validation.same_numbers import differences, numbers_of, terminal_differences

FORCE = np.random.default_rng(0).normal(size=(60, 2))
NEVER = 0.123456


def run(folder, document, table, **arrays):
    """A run with a document, a table and long arrays, and its numbers."""
    folder.mkdir()
    (folder / "metrics.json").write_text(json.dumps(document))
    (folder / "table.csv").write_text("\n".join(table))
    np.savez(folder / "results.npz", **arrays)
    return numbers_of(folder)


def test_what_moved_is_found_and_what_changed_is_listed(tmp_path):
    before = run(
        tmp_path / "before",
        {"error": 0.25, "seconds": 3.0, "noise": 0.017, "lost": NEVER},
        ["t,share", "0,0.5", "1,0.75"],
        force=FORCE,
        sd=np.arange(150.0),
    )
    after = run(
        tmp_path / "after",
        {"errors": [0.25, 0.1], "seconds": 4.0, "noise": 0.017 * (1 + 1e-8)},
        ["t,share [%]", "0,50", "1,75"],
        force_x=FORCE[:, 0],
        force_y=FORCE[:, 1],
        sd=1.001 * np.arange(150.0),
    )
    found = differences(before, after)
    assert [line.split()[0] for line in found.missing] == [
        "metrics.json:.lost",
        "results.npz:sd",
    ]
    assert len(found.same) == 2  # noise, and the column t
    assert len(found.elsewhere) == 3
    assert differences(before, before).missing == []


def test_numbers_of_a_terminal_are_compared_as_words():
    before, after = "error 0.25 ± 0.01 in 12 steps", "12 steps, error 0.26 ± 0.01"
    assert terminal_differences(before, after) == ["0.25"]
