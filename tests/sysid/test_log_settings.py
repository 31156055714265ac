"""log.toml: what it says is as good as the same options, and gives way to them."""

from pathlib import Path

import pytest

from sysid import InvalidInput
from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.cli.log_settings import settings_in, with_settings

FULL = """
columns = {t = "sec", theta = "deg"}
zero = "hanging"
flip-torque = true
degrees = false
from = 2
to = 9.5
time_unit = "ms"
noise = "theta=0.1"
plant = "joint"
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "log.toml").write_text(FULL)
    return tmp_path


def test_what_the_file_says_holds_where_the_command_line_is_silent(folder):
    log, start, said = with_settings(LogOptions((folder / "a.csv",)), ModelOptions())
    assert (log.columns, log.zero, log.flip_torque, log.degrees) == ("t=sec,theta=deg", "hanging", True, False)
    assert (log.begin, log.end, log.time_unit, log.noise, start.plant) == (2.0, 9.5, "ms", "theta=0.1", "joint")
    assert said.startswith(f"{folder / 'log.toml'}: columns t=sec,theta=deg; zero hanging; flip_torque true;")
    assert "\n" not in said and "overrides" not in said


def test_the_zero_may_be_a_number(folder):
    (folder / "log.toml").write_text("zero = 2\n")
    log, _, said = with_settings(LogOptions((folder / "a.csv",)), ModelOptions())
    assert log.zero == 2.0 and log.reading()["zero"] == 2.0 and said.endswith("zero 2.0")


def test_the_command_line_overrides_it_and_is_told_so(folder):
    log, start, said = with_settings(
        LogOptions((folder / "a.csv",), zero="upright", begin=0.0), ModelOptions(plant="rod")
    )
    assert (log.zero, log.begin, log.end, start.plant) == ("upright", 0.0, 9.5, "rod")
    assert said.endswith("(the command line overrides zero, from, plant)")


def test_a_file_elsewhere_or_none(folder, tmp_path_factory):
    log = (tmp_path_factory.mktemp("bare") / "a.csv",)
    assert with_settings(LogOptions(log), ModelOptions())[2] == ""
    assert with_settings(LogOptions(log, settings=folder / "log.toml"), ModelOptions())[0].zero == "hanging"
    silent = with_settings(LogOptions((folder / "a.csv",), settings=Path("none")), ModelOptions())
    assert silent == (LogOptions((folder / "a.csv",)), ModelOptions(), "")


def test_logs_of_several_folders_need_one_that_holds_for_all(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    files = (folder / "a.csv", other / "b.csv")
    with pytest.raises(InvalidInput, match=r"the logs lie in 2 folders .* --log FILE.toml"):
        with_settings(LogOptions(files), ModelOptions())
    (other / "log.toml").write_text(FULL)
    assert with_settings(LogOptions(files), ModelOptions())[0].zero == "hanging"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("zeor = 'hanging'", "unknown key 'zeor': did you mean zero? Expected some of columns, zero, flip_torque"),
        ("xyz = 1", "unknown key 'xyz': expected some of columns"),
        ("zero = 'left'", "zero = 'left': expected upright, hanging or a number"),
        ("degrees = 'yes'", "degrees = 'yes': expected true or false"),
        ("from = true", "from = True: expected a number"),
        ("plant = 'arm'", "plant = 'arm': expected rod, point, joint or axis"),
        ("columns = 3", "columns = 3: expected a table, as {theta = ...}"),
        ("zero = [1]", "zero = [1]: expected upright, hanging or a number"),
        ("zero = hanging", "is not TOML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence(text, message, tmp_path):
    (tmp_path / "log.toml").write_text(text)
    with pytest.raises(InvalidInput) as refusal:
        settings_in(tmp_path / "log.toml")
    assert message in str(refusal.value) and "\n" not in str(refusal.value)
