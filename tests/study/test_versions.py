"""The start-up check: a foreign distribution named sysid is noticed, a foreign package of that name is refused."""

import os
import subprocess
import sys
from pathlib import Path

from study.pipeline.settings import versions

ROOT = Path(__file__).resolve().parents[2]


def start(folder, *arguments):
    """`python -m study.main` with a folder that comes before this checkout on the path."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(folder), str(ROOT)))}
    return subprocess.run(
        [sys.executable, "-m", "study.main", *arguments], cwd=folder, env=environment, capture_output=True,
        text=True, timeout=60, check=False,
    )  # fmt: skip


def test_here_everything_is_ours(tmp_path):
    said = start(tmp_path, "--workers", "-1").stderr
    assert said.startswith("error: --workers -1") and said.count("\n") == 1
    assert {"python", "gapfinder", "torch"} <= set(versions())


def test_a_foreign_distribution_is_noticed(tmp_path):
    (tmp_path / "sysid-0.4.dist-info").mkdir()
    (tmp_path / "sysid-0.4.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: sysid\nVersion: 0.4\n")
    said = start(tmp_path, "--workers", "-1").stderr
    assert "warning: the foreign distribution 'sysid' 0.4 is installed" in said
    assert "pip uninstall sysid" in said


def test_a_foreign_package_is_refused(tmp_path):
    (tmp_path / "sysid").mkdir()
    (tmp_path / "sysid" / "__init__.py").write_text("")
    answer = start(tmp_path)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert f"`import sysid` finds {tmp_path / 'sysid'}, expected {ROOT / 'sysid'}" in answer.stderr
    assert not (tmp_path / "results").exists()
