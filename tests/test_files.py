import errno
import os
import subprocess
import sys

import pytest

from pinav.errors import InputError
from pinav.files import atomic_write, write_text

resource = pytest.importorskip("resource", reason="limits of a process are POSIX")


def fail_with_full_disk(*args):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def names(folder):
    return [path.name for path in folder.iterdir()]


def test_text_is_written_in_utf8(tmp_path):
    write_text(tmp_path / "a.txt", "µm\n")
    assert (tmp_path / "a.txt").read_bytes() == "µm\n".encode()
    assert names(tmp_path) == ["a.txt"]


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


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, call):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    monkeypatch.setattr(os, call, fail_with_full_disk)
    message = r"a\.txt: cannot write: No space left on device"
    with pytest.raises(InputError, match=message) as raised:
        write_text(path, "new", overwrite=True)
    assert isinstance(raised.value.__cause__, OSError)
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_interrupted_writer_leaves_nothing(tmp_path):
    def write(file):
        file.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atomic_write(tmp_path / "a.txt", write)
    assert names(tmp_path) == []


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
    assert names(tmp_path) == ["a.txt"]


def test_folder_must_exist_and_must_not_be_the_target(tmp_path):
    with pytest.raises(InputError, match="cannot write: no folder .*absent; make it"):
        write_text(tmp_path / "absent" / "a.txt", "")
    with pytest.raises(InputError, match="expected the name of a file, got a folder"):
        write_text(tmp_path, "", overwrite=True)
