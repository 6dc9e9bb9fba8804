"""Damage to files by rule: bytes of any file, words of a text, arrays of an archive."""

import io
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

Rule = Callable[[bytes, random.Random], bytes]

WORDS = (
    *("nan", "-1", "0", "1e300", "1e-300", "null", "true", '"x"', "[]", "{}", ""),
    *("[1, 2]", "123456789012345678901", "../x", "\u00e9"),
)
"""What a value of a text is replaced by."""


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The content with one damage; half of those of a text or an archive are inside."""
    rules: list[Rule] = [damage_bytes] * 5
    if content[:2] == b"PK":
        rules += 5 * [change_member]
    elif _is_text(content):
        rules += [change_value] * 3 + [drop_line, repeat_line]
    return rng.choice(rules)(content, rng)


def damage_bytes(content: bytes, rng: random.Random) -> bytes:
    """The content cut, with bytes changed, turned round, replaced, or empty."""
    return rng.choice((cut, scratch, turn, replace_all, empty))(content, rng)


def damage(file: Path, rng: random.Random) -> None:
    """Damage a file, or remove it in one case of ten."""
    if rng.random() < 0.1:
        file.unlink()
    else:
        file.write_bytes(damaged(file.read_bytes(), rng))


def cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def scratch(content: bytes, rng: random.Random) -> bytes:
    place, junk = rng.randrange(len(content) + 1), _junk(rng)
    return content[:place] + junk + content[place + len(junk) :]


def turn(content: bytes, rng: random.Random) -> bytes:
    place = rng.randrange(len(content) + 1)
    return content[place:] + content[:place]


def replace_all(content: bytes, rng: random.Random) -> bytes:
    return _junk(rng)


def empty(content: bytes, rng: random.Random) -> bytes:
    return b""


def change_value(content: bytes, rng: random.Random) -> bytes:
    """A number or a quoted word of the text becomes something else."""
    text = content.decode()
    values = list(re.finditer(r'-?\d[\d.eE+-]*|"[^"\n]*"', text))
    if not values:
        return empty(content, rng)
    value = rng.choice(values)
    return (text[: value.start()] + rng.choice(WORDS) + text[value.end() :]).encode()


def drop_line(content: bytes, rng: random.Random) -> bytes:
    lines = content.splitlines(keepends=True) or [b""]
    del lines[rng.randrange(len(lines))]
    return b"".join(lines)


def repeat_line(content: bytes, rng: random.Random) -> bytes:
    lines = content.splitlines(keepends=True) or [b""]
    lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return b"".join(lines)


def change_member(content: bytes, rng: random.Random) -> bytes:
    """An array of the archive is lost, cut, turned, of another type or not finite."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(sorted(members))
    array = np.load(io.BytesIO(members.pop(name)), allow_pickle=False)
    change = rng.choice(ARRAYS)
    if change is not None:
        file = io.BytesIO()
        np.save(file, change(array))
        members[name] = file.getvalue()
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return whole.getvalue()


ARRAYS: tuple[Callable[[np.ndarray], np.ndarray] | None, ...] = (
    None,
    lambda a: a[:0] if a.ndim else np.zeros(0),
    lambda a: a[:-1] if a.ndim else a[None],
    lambda a: a.T[..., None],
    lambda a: np.full(a.shape, "x"),
    lambda a: np.full(a.shape, np.nan),
    lambda a: np.full(a.shape, 1e300),
    lambda a: np.full(a.shape, -1),
)
"""What becomes of an array; None: it is lost."""


def _junk(rng: random.Random) -> bytes:
    return bytes(rng.randrange(256) for _ in range(rng.randrange(1, 20)))


def _is_text(content: bytes) -> bool:
    try:
        return "\0" not in content.decode()
    except UnicodeDecodeError:
        return False
