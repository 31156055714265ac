"""Runs from files: ours and the authors' through one reader, and files that are none."""

import math

import pytest

from study.main import main
from study.paper.finished_runs import Outcomes, Run, outcomes, read_published, read_runs, run_table
from study.paper.presets import Cell
from study.paper.published_numbers import POINTS, Spot
from study.pipeline.tables import write_rows
from sysid import InvalidInput

HEADER = "n,w,seed,id_error,eval_return_mean,theta_hat_mass,theta_hat_length"


def write(path, *rows, header=HEADER):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_our_own_table_reads_back(answer, tmp_path):
    write_rows(tmp_path / "runs.csv", *run_table(answer.runs))
    runs = read_runs(tmp_path / "runs.csv")
    assert runs.points == ("main",)
    assert runs.budgets("main") == answer.point.budgets
    for key in answer.cells:
        assert runs.returns(Spot("main", *key)) == pytest.approx(answer.returns(key))
    assert runs.id_errors("main", 5).mean() == pytest.approx(answer.id_error(5))
    assert runs.summary(Spot("main", 0, 0.5), fresh=True).mean != runs.summary(Spot("main", 0, 0.5)).mean


def test_the_authors_files_are_told_apart_by_their_names_and_missing_ones_are_named(tmp_path):
    row = "0,0.5,3,1.1,-700,1.0,1.0"
    write(tmp_path / "summary.csv", row)
    write(tmp_path / "exp_priorDR.csv", row)
    published = read_published(tmp_path)
    assert set(published.table) == {Spot("main", 0, 0.5), Spot("prior_range", 0, 0.5)}
    assert set(published.missing) == {p.file for p in POINTS.values()} - {"summary.csv", "exp_priorDR.csv"}
    assert math.isnan(published.table[Spot("main", 0, 0.5)][3].fresh_mean)


def test_only_seeds_that_all_cells_have_are_shared():
    runs = outcomes(Run(Cell("main", n, 0.0, seed), (1.0, 1.0), 0.0, -1.0) for n in (0, 5) for seed in range(n + 2))
    assert runs.seeds(Spot("main", 0, 0.0), Spot("main", 5, 0.0)) == (0, 1)
    assert runs.seeds(Spot("main", 9, 0.0)) == ()


def test_merging_adds_cells_and_replaces_none():
    spots = Spot("main", 0, 0.0), Spot("main", 5, 0.0)
    mine, other = (Outcomes({spot: {0: Run(Cell(*spot, 0), (1.0, 1.0), 0.0, value)} for spot in spots[:k]})
                   for k, value in ((1, -1.0), (2, -2.0)))  # fmt: skip
    merged = mine.merged(other)
    assert [merged.summary(spot).mean for spot in spots] == [-1.0, -2.0]


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        ((), "n,w,seed", "no column 'id_error'"),
        (("0,0.5,x,1.1,-700,1.0,1.0",), HEADER, "line 2"),
        (("0,0.5,1,1.1,nan,1.0,1.0",), HEADER, "NaN"),
        (("0,0.5,1,1.1,-700,inf,1.0",), HEADER, "infinity"),
        (("0,0.5",), HEADER, "line 2 does not hold the numbers of a row"),
        (("0,0.5,1,1.1,-700,1,1", "0,0.5,1,1.1,-700,1,1"), HEADER, "seed 1 comes twice"),
    ],
)
def test_files_that_are_no_runs_are_refused_by_name(rows, header, message, tmp_path):
    with pytest.raises(InvalidInput, match=message) as error:
        read_runs(write(tmp_path / "runs.csv", *rows, header=header))
    assert "runs.csv" in str(error.value)


def test_folders_without_any_of_the_files_are_refused_before_anything_runs(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "nowhere"):
        code = main(["--preset", "smoke", "--out", str(tmp_path / "out"), "--published", str(folder)])
        assert code == 2
        assert "sim2real_budget" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidInput, match="not a table"):
        read_runs(tmp_path / "binary.csv")
    with pytest.raises(InvalidInput, match="no such file"):
        read_runs(tmp_path / "missing.csv")
