import errno
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.live.sessions import begun, feed, frame_line

from pinav.errors import InputError
from pinav.figures import save_figure
from pinav.files import atomic_write, write_text
from pinav.live.checkpoint import write_session
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories, save

resource = pytest.importorskip("resource", reason="limits of a process are POSIX")


def fail_with_full_disk(*args):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.*"))}


def tracks(text):
    return Trajectories.from_arrays(
        np.arange(float(len(text))), np.zeros((len(text), 1)), channels=("x",)
    )


def draw(folder, text):
    figure = Figure()
    figure.suptitle(text)
    save_figure(figure, folder, "a")


def keep_session(folder, text):
    lines = [frame_line(number) for number in range(len(text))]
    write_session(folder / "a.npz", feed(begun(), lines)[0])


WRITERS = {
    "text": lambda folder, text: write_text(folder / "a.txt", text, overwrite=True),
    "npz": lambda folder, text: save(tracks(text), folder / "a.npz", overwrite=True),
    "csv": lambda folder, text: save(tracks(text), folder / "a.csv", overwrite=True),
    "result": lambda folder, text: RunFolder(folder).write_json("a.json", text),
    "session": keep_session,
    "figure": draw,
}


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_a_full_disk_leaves_the_old_files_alone(tmp_path, monkeypatch, write, call):
    write(tmp_path, "old")
    before = contents(tmp_path)
    monkeypatch.setattr(os, call, fail_with_full_disk)
    with pytest.raises((InputError, OSError), match="No space left on device") as error:
        write(tmp_path, "newer")
    if error.type is InputError:
        assert re.search(r"a\.\w+: cannot write: No space", str(error.value))
        assert isinstance(error.value.__cause__, OSError)
    assert contents(tmp_path) == before
    monkeypatch.undo()
    write(tmp_path, "newer")
    assert contents(tmp_path).keys() == before.keys()
    assert contents(tmp_path) != before


def test_text_is_written_in_utf8(tmp_path):
    write_text(tmp_path / "a.txt", "µm\n")
    assert (tmp_path / "a.txt").read_bytes() == "µm\n".encode()
    assert [*contents(tmp_path)] == ["a.txt"]


def test_existing_file_is_kept_unless_overwriting(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(InputError, match=r"a\.txt: exists already; choose another"):
        write_text(path, "new")
    assert path.read_text() == "old"
    write_text(path, "new", overwrite=True)
    assert path.read_text() == "new"


def test_file_has_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    write_text(tmp_path / "a.txt", "")
    modes = [(tmp_path / name).stat().st_mode for name in ("plain", "a.txt")]
    assert modes[0] == modes[1]


def test_interrupted_writer_leaves_nothing(tmp_path):
    def write(file):
        file.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atomic_write(tmp_path / "a.txt", write)
    assert not contents(tmp_path)


def test_system_that_refuses_to_write_leaves_the_old_file(tmp_path):
    """A real failing write: the process may not make files above 1 kB."""
    path = tmp_path / "a.txt"
    write_text(path, "old")
    code = (
        "import resource, signal, sys\n"
        "from pinav.files import write_text\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "write_text(sys.argv[1], 'x' * 100_000, overwrite=True)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        check=False,
        capture_output=True,
        text=True,
    )
    assert "a.txt: cannot write: File too large" in run.stderr
    assert path.read_text() == "old"
    assert [*contents(tmp_path)] == ["a.txt"]


def test_folder_must_exist_and_must_not_be_the_target(tmp_path):
    with pytest.raises(InputError, match="cannot write: no folder .*absent; make it"):
        write_text(tmp_path / "absent" / "a.txt", "")
    with pytest.raises(InputError, match="expected the name of a file, got a folder"):
        write_text(tmp_path, "", overwrite=True)
