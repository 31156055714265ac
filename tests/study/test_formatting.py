"""Printed numbers: rounded, a minus sign that is one, never minus zero, and infinity as it is."""

import math

import pytest

from study.formatting import MINUS, bracketed, number, percent, signed


@pytest.mark.parametrize(
    ("value", "digits", "plain", "with_sign"),
    [
        (-338.4, 0, f"{MINUS}338", f"{MINUS}338"),
        (87.3, 0, "87", "+87"),
        (-0.3, 0, "0", "+0"),
        (-0.0023, 3, f"{MINUS}0.002", f"{MINUS}0.002"),
        (-0.0023, 2, "0.00", "+0.00"),
        (-math.inf, 0, f"{MINUS}inf", f"{MINUS}inf"),
    ],
)
def test_a_number_is_rounded_and_never_minus_zero(value, digits, plain, with_sign):
    assert number(value, digits) == plain
    assert signed(value, digits) == with_sign


def test_an_interval_is_written_as_its_number_is():
    assert bracketed(44.2, -0.2, 73.9) == "44 [0, 74]"
    assert bracketed(44.2, -5.2, 73.9, write=signed) == f"+44 [{MINUS}5, +74]"
    assert percent(0.953) == "95 %"
