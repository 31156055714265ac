"""The speed benchmark counts what an update multiplies, and its contenders run."""

import pytest

from tests.benchmarks.training import BATCH, OURS, SACLOSS, main, products

pytestmark = pytest.mark.long


def test_the_work_of_an_update_is_sixteen_products_of_its_hidden_layers():
    wide = 4096
    assert products((wide, wide)) / (2.0 * BATCH * wide * wide) == pytest.approx(16.0, rel=0.01)


def test_the_contenders_take_turns_and_end_in_a_table(capsys):
    assert main(["--hidden", "8", "--agents", "2", "--rounds", "1", "--seconds", "0.01"]) == 0
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert {OURS, SACLOSS} <= {row[0].strip() for row in rows[2:]}
    for row in rows[2:]:
        assert float(row[3]) > 0.0 and float(row[7].split()[0]) > 0.01
