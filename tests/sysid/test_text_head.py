"""The head of a text file: names, delimiter and first row of numbers, whatever stands above and beside them."""

import numpy as np
import pytest

from sysid.data.text_head import Head, cells, head
from tests.sysid.written import read, rollouts, same, table, write

NAMES = ("t", "theta", "torque")
ROWS = [f"{0.02 * k},{0.1 * k},{-k}" for k in range(30)]
ABOVE = {
    "nothing": [],
    "a title": ["Swing of the second pendulum"],
    "what was set": ["Log of a rig", "rate,50", "gain,1.5,2", ""],
    "comments": ["# a rig of ours", "# at 50 Hz, in June"],
}
NAMING = {
    "names": [",".join(NAMES)],
    "names and units": [",".join(NAMES), "s,rad,N m"],
    "a comment": ["# " + ",".join(NAMES)],
    "names with a delimiter at the end": [",".join(NAMES) + ","],
}


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("naming", NAMING)
@pytest.mark.parametrize("above", ABOVE)
def test_the_row_of_names_is_found_below_whatever_stands_above(above, naming, delimiter):
    top = [*ABOVE[above], *(line.replace(",", delimiter) for line in NAMING[naming])]
    end = delimiter * naming.endswith("end")
    found = head([f"{line}\n" for line in (*top, *(row.replace(",", delimiter) + end for row in ROWS))])
    assert found is not None and tuple(n for n in found.names if n) == NAMES
    assert (found.delimiter, found.above) == (delimiter, len(top))


@pytest.mark.parametrize("row", ["0,1,2", "0.5;1,5;2,5", "0,5\t1\t2", "0,5 1,5 2,5", " 0.1  2  3"])
@pytest.mark.parametrize("above", [[], ["A title"], ["# a comment of five words here"]])
def test_without_names_columns_are_numbered(row, above):
    found = head([f"{line}\n" for line in (*above, *[row] * 20)])
    assert found is not None and found.names == ("1", "2", "3") and found.above == len(above)
    assert all(np.isfinite(float(cell)) for cell in cells(row, found.delimiter))


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_an_empty_first_cell_is_a_cell(delimiter):
    lines = [f"{line}\n".replace(",", delimiter) for line in (",t,theta,", *(f",{0.02 * k},{k}," for k in range(9)))]
    assert head(lines) == Head(("", "t", "theta", ""), delimiter, 1)


def test_rows_may_have_any_number_of_cells():
    row = ",".join(["0.5"] * 100_000) + "\n"
    found = head([row, row])
    assert found is not None and found.names[-1] == "100000"


def test_names_that_are_numbers_are_names_beside_one_that_is_none():
    found = head(["time,0,1\n", *[f"{row}\n" for row in ROWS]])
    assert found == Head(("time", "0", "1"), ",", 1)


def test_a_column_of_words_or_of_empty_cells_is_no_head():
    rows = [f"{0.02 * k},{'' if k % 3 else 0.1 * k},{('off', 'on')[k > 4]}\n" for k in range(40)]
    assert head(["t,theta,state\n", *rows]) == Head(("t", "theta", "state"), ",", 1)


def test_lines_that_end_twice_and_columns_beyond_the_names_do_no_harm():
    assert head(["time,angle\n", "\n", *[f"{0.1 * k},{k}\n\n" for k in range(9)]]) == Head(("time", "angle"), ",", 2)
    found = head(["t;theta;torque\n", *[f"{row.replace(',', ';')};0;0\n" for row in ROWS]])
    assert found == Head(NAMES, ";", 1)


def test_a_file_of_names_alone_has_no_numbers_and_an_empty_one_no_head():
    assert head(["t,theta\n"]) == Head(("t", "theta"), ",", 1)
    assert head(["\n", "#\n"]) is None


def test_a_log_below_lines_about_it_is_the_log(tmp_path):
    (record,) = rollouts()
    plain = read(write(tmp_path / "log.csv", table(record)))
    names, *rows = (tmp_path / "log.csv").read_text().splitlines()
    top = ["[Pendulum 3, June]", "Rate:,50,Hz", names, "s,rad,rad/s,N m"]
    (tmp_path / "log.csv").write_text("\n".join([*top, *rows]))
    same(read(tmp_path / "log.csv")[0], plain[0])
    np.savetxt(tmp_path / "log.csv", np.column_stack(list(table(record).values())), header="t theta theta_dot torque")
    same(read(tmp_path / "log.csv")[0], plain[0], rtol=1e-12)
