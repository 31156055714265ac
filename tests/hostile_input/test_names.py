"""Whatever a file is called, a command answers, or says in one sentence why not."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import sysid
from policies.storage.policy_file import load_policy
from sysid.cli.log_settings import settings_in as log_settings
from sysid.data.files import check_outputs
from tests.hostile_input.answering import ESC, MODEL, answered, many

NAMES = st.one_of(
    st.text(st.characters(codec=None), max_size=20),
    st.sampled_from(
        ["", ".", "loop", "loop/log.csv", "a\0b", "\ud800", "a\udc80", "x" * 300, "y/" * 3000, "fifo", ESC]
    ),
)
READERS = (sysid.read, sysid.load, sysid.load_effects, load_policy, log_settings)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a loop of links and a pipe that nobody writes to."""
    path = tmp_path_factory.mktemp("names")
    (path / "loop").symlink_to("loop")
    os.mkfifo(path / "fifo")
    return path


@many
@given(name=NAMES, suffix=st.sampled_from(["", ".csv", ".npz", ".mat", ".json", ".py"]))
def test_no_name_ends_in_a_traceback(folder, name, suffix):
    path = Path(f"{folder}/{name}{suffix}")
    for reader in READERS:
        assert not answered(reader, path)


@many
@given(name=NAMES)
def test_no_name_of_an_output_ends_in_a_traceback_or_takes_the_place_of_a_device(folder, name):
    path = Path(f"{folder}/{name}")
    if answered(check_outputs, [], [path]):
        assert path.parent.is_dir() and not path.exists()
    for device in ("fifo", "loop"):
        assert not answered(sysid.save, MODEL, folder / device)
    assert (folder / "fifo").is_fifo() and (folder / "loop").is_symlink()
