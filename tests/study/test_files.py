"""A file is whole or the one before: a full disk leaves no half of it."""

import errno
import os
import subprocess
import sys

import pytest

from sysid.data.files import partial, whole, write_whole

FULL = """
import resource, signal, sys
from pathlib import Path
from sysid.data.files import write_whole
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_whole(Path(sys.argv[1]), "x" * 5000)
except OSError as error:
    print(error)
"""


def test_what_was_written_is_there(tmp_path):
    path = tmp_path / "table.csv"
    write_whole(path, "old\n")
    write_whole(path, "θ\n")
    assert path.read_text(encoding="utf-8") == "θ\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_limit_of_the_system_keeps_the_older_file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old\n")
    said = subprocess.run([sys.executable, "-c", FULL, path], capture_output=True, text=True, check=True).stdout
    assert said == f"[Errno {errno.EFBIG}] File too large: '{path}'\n"
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_is_full_when_the_file_should_reach_it_keeps_the_older_file(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "table.csv"
    path.write_text("old\n")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*table.csv'"):
        write_whole(path, b"new")
    assert path.read_text() == "old\n"
    assert not partial(path).exists()


def test_a_writer_that_raises_keeps_the_older_file_and_leaves_no_rest(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old\n")
    with pytest.raises(ZeroDivisionError), whole(path) as file:
        file.write(b"half of it")
        raise ZeroDivisionError
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]
