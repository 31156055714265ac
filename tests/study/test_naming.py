"""Naming the missing effect: what counts as right, and a table that goes on where it stopped."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from study.mismatch import naming
from study.mismatch.mismatch_plan import MISMATCH_PLANS
from study.mismatch.naming import (
    BUDGETS,
    FIRST,
    NAMING_TABLE,
    NamingExperiment,
    NamingResult,
    is_right,
    main,
    measure,
    naming_errors,
    naming_table,
    read_naming,
    write_naming,
)
from study.pipeline.executor import WorkerFailed
from study.trials.hidden_plant import COULOMB, DELAY_LARGE, MAGNET, PLAIN
from sysid import InvalidInput
from tests.study.inline import Inline

PLAN = MISMATCH_PLANS["mismatch"]


@pytest.mark.parametrize(
    ("plant", "verdict", "steps", "right"),
    [
        (PLAIN, "adequate", (), True),
        (PLAIN, "missing", ("viscous",), False),
        (COULOMB, "missing", ("coulomb",), True),
        (COULOMB, "missing", ("asymmetric_coulomb",), True),
        (COULOMB, "missing", ("lugre",), True),
        (COULOMB, "missing", ("coulomb", "tilt"), False),
        (COULOMB, "missing", ("viscous",), False),
        (COULOMB, "unknown", ("coulomb",), False),
        (COULOMB, "adequate", (), False),
        (DELAY_LARGE, "cannot tell", ("sensor_delay/delay",), True),
        (DELAY_LARGE, "cannot tell", ("lag/dead_zone",), False),
        (MAGNET, "unknown", (), True),
        (MAGNET, "unknown", ("spring",), True),
        (MAGNET, "partly", ("spring",), True),
        (COULOMB, "partly", ("coulomb",), False),
        (MAGNET, "missing", ("spring",), False),
    ],
)
def test_right_is_the_effect_or_one_that_contains_it_and_nothing_else(plant, verdict, steps, right):
    assert is_right(plant, verdict, steps) is right


def row(n, seed, steps=("delay",), verdict="missing", plant=DELAY_LARGE, error=0.1):
    return NamingResult(plant.name, n, seed, verdict, steps, is_right(plant, verdict, steps), error, 0.5 * error)


def test_errors_are_root_mean_squares_of_what_could_be_fitted():
    rows = [row(5, 0, error=0.3), row(5, 1, error=0.4), row(5, 2, (), naming.REFUSED, error=math.nan)]
    assert naming_errors(rows) == pytest.approx((math.sqrt(0.125), 0.5 * math.sqrt(0.125)))
    assert np.isnan(naming_errors([])).all()


def test_what_allows_no_fit_is_a_row_that_is_not_right():
    class Refusing:
        @property
        def diagnosis(self):
            raise InvalidInput("too short")

    result = measure(DELAY_LARGE, 1, FIRST, Refusing())
    assert (result.verdict, result.right, math.isnan(result.error_fitted)) == (naming.REFUSED, False, True)


@pytest.mark.long
def test_a_delay_is_named_and_m_and_l_are_closer_with_it():
    plan = dataclasses.replace(PLAN, plants=(DELAY_LARGE, PLAIN), budgets=(0, 2))
    results = {}
    for task in tasks(plan, (), (2,), 1):
        (results[task.arguments[1]],) = task.run(Inline())
    assert results["delay_large"].right
    assert results["delay_large"].steps[0].startswith("delay")
    assert results["delay_large"].error_mended < 0.3 * results["delay_large"].error_fitted
    assert results["plain"].verdict == "adequate"
    assert results["plain"].error_mended == results["plain"].error_fitted < 0.05


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = [row(5, 1, ("delay/sensor_delay", "tilt")), row(5, 0, ()), row(1, 0), row(50, 0, (), "adequate", PLAIN)]
    write_naming(tmp_path / NAMING_TABLE, rows)
    assert read_naming(tmp_path / NAMING_TABLE) == [rows[3], rows[2], rows[1], rows[0]]
    assert read_naming(tmp_path / "none.csv") == []


def test_seeds_vary_slowest_and_only_what_is_missing_is_measured():
    asked = [task.arguments[1:] for task in tasks(PLAN, [row(1, FIRST), row(5, FIRST + 1)], (1, 5), 2)]
    assert [seed for _, seed, _ in asked] == [FIRST] * 6 + [FIRST + 1] * 6
    assert {(plant, seed): budgets for plant, seed, budgets in asked if len(budgets) < 2} == {
        ("delay_large", FIRST): (5,),
        ("delay_large", FIRST + 1): (1,),
    }
    everything = [row(n, s, plant=p) for n in BUDGETS for s in range(FIRST, FIRST + 3) for p in PLAN.plants]
    assert list(tasks(PLAN, everything, BUDGETS, 3)) == []


def tasks(plan, known, budgets, seeds):
    experiment = NamingExperiment(plan, Path("nowhere.csv"), budgets, seeds)
    experiment.rows = list(known)
    return experiment.left()


def test_a_table_tells_rates_and_errors_in_percent_and_leaves_out_what_was_not_measured():
    table = naming_table([row(5, 0), row(5, 1, ()), row(20, 0), row(20, 0, (), "adequate", PLAIN, 0.02)])
    assert "of 1 to 2 seeds" in table.title
    assert {column.header: list(column.cells) for column in table.columns} == {
        "hidden plant": ["Nothing missing", "Delay 0.155 s"],
        "n = 5": ["", "50 [9, 91]\n(10, 5)"],
        "n = 20": ["100 [21, 100]\n(2, 1)", "100 [21, 100]\n(10, 5)"],
    }


def test_a_run_goes_on_from_its_table(tmp_path, monkeypatch, capsys):
    done, most = [], 3

    def execute(self, left, heard):
        for task in left:
            if len(done) == most:
                raise KeyboardInterrupt
            done.append(task.arguments[1])
            heard(task, "done", invented(task))

    monkeypatch.setattr("study.pipeline.executor.Processes.execute", execute)
    command = ["--out", str(tmp_path), "--seeds", "1", "--budgets", "1", "2"]
    assert main(command) == 130
    assert len(read_naming(tmp_path / NAMING_TABLE)) == 6
    most = 6
    assert main(command) == 0
    assert done == [plant.name for plant in PLAN.plants]
    capsys.readouterr()
    assert main(["--out", str(tmp_path)]) == 0
    assert len(done) == 6
    said = capsys.readouterr().out
    assert "of 1 seeds" in said and "(10, 5)" in said


def invented(task):
    _, plant, seed, budgets = task.arguments
    return [row(n, seed, plant=PLAN.plant(plant)) for n in budgets]


@pytest.mark.parametrize("arguments", [["--seeds", "0"], ["--seeds", "101"], ["--seeds", "1", "--workers", "0"], []])
def test_what_is_no_table_or_no_number_is_refused_in_a_line(tmp_path, capsys, arguments):
    (tmp_path / NAMING_TABLE).write_text("a,b\n1,2\n")
    assert main(["--out", str(tmp_path), *arguments]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ")
    assert message.count("\n") == 1
    assert (tmp_path / NAMING_TABLE).read_text() == "a,b\n1,2\n"


def test_without_a_table_nothing_is_told_and_no_folder_made(tmp_path, capsys):
    assert main(["--out", str(tmp_path / "none")]) == 2
    assert "has no naming.csv: measure one with --seeds 100" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_row_of_a_plant_that_is_not_in_the_plan_is_refused(tmp_path):
    write_naming(tmp_path / NAMING_TABLE, [row(5, 0)])
    text = (tmp_path / NAMING_TABLE).read_text()
    (tmp_path / NAMING_TABLE).write_text(text.replace(row(5, 0).plant, "slew_old"))
    with pytest.raises(InvalidInput, match="plant 'slew_old': expected one of plain"):
        read_naming(tmp_path / NAMING_TABLE)


def test_a_task_that_fails_ends_with_a_sentence_and_code_1(tmp_path, monkeypatch, capsys):
    def execute(self, left, heard):
        raise WorkerFailed("naming at plain failed:\n no memory")

    monkeypatch.setattr("study.pipeline.executor.Processes.execute", execute)
    assert main(["--out", str(tmp_path), "--seeds", "1"]) == 1
    assert capsys.readouterr().err == "error: naming at plain failed: no memory\n"
