"""The wheel is what users get: it holds what runs and nothing else, and it runs where no source tree is."""

import importlib.metadata
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="needs the extra [dev]")

ROOT = Path(__file__).parents[1]


def run(*words, **options):
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def pip(*words):
    run("-m", "pip", "--disable-pip-version-check", "--no-input", *words, cwd=ROOT)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel's file, built without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-build-isolation", "--no-index", "--no-deps", "--wheel-dir", folder, ROOT)
    (file,) = folder.glob("gapfinder-*.whl")
    return file


def test_it_holds_the_packages_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    for package in ("sysid", "policies", "study"):
        sources = (path for path in (ROOT / package).rglob("*") if path.suffix in (".py", ".pyi", ".j2", ".css"))
        assert {f"{package}/py.typed", *(str(path.relative_to(ROOT)) for path in sources)} <= names
    assert {name.split("/")[0] for name in names} == {"sysid", "policies", "study"}
    assert not any(name.startswith("study/results") or "test" in Path(name).parts for name in names)


@pytest.mark.parametrize(
    "module",
    [
        "sysid.__main__",
        "policies.__main__",
        "study.main",
        "study.worth.__main__",
        "study.mismatch.naming",
        "study.mismatch.effect_cost",
    ],
)
def test_every_command_says_its_version(module, capsys):
    assert importlib.import_module(module).main(["--version"]) == 0
    assert capsys.readouterr().out == f"gapfinder {importlib.metadata.version('gapfinder')}\n"


@pytest.mark.long
def test_installed_it_diagnoses_a_log(wheel, tmp_path):
    pip("install", "--no-index", "--no-deps", "--target", tmp_path / "site", wheel)
    away = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": str(tmp_path / "site")}}
    assert Path(run("-c", "import sysid; print(sysid.__file__)", **away).strip()).is_relative_to(tmp_path)
    for command, word in (("sysid", "--version"), ("gapfinder-study", "--version"), ("gapfinder-policies", "--help")):
        assert run(tmp_path / "site" / "bin" / command, word, **away)
    run(ROOT / "examples" / "hidden_effect.py", "--only-log", "--log", tmp_path / "log", **away)
    logs = sorted(tmp_path.rglob("swing*.csv"))
    said = run("-m", "sysid", "diagnose", *logs, "--html", "report.html", **away)
    assert "missing: delay" in said
    assert "<html" in (tmp_path / "report.html").read_text()
