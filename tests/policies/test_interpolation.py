"""Interpolation is exact for what is linear, goes around a circle, and ends where a line ends."""

import math

import numpy as np
import pytest

from policies.control.dynamic_programming import Axis, corners

CIRCLE, LINE, THIRD = Axis(2.0 * math.pi, 8, circle=True), Axis(6.0, 7), Axis(4.0, 5)


def interpolate(table, axes, point):
    nodes, weights = corners(axes, point)
    return np.sum(table.ravel()[nodes] * weights, axis=-1)


@pytest.mark.parametrize("axes", [(LINE,), (LINE, THIRD), (THIRD, LINE, Axis(2.0, 3))])
def test_a_function_linear_in_each_coordinate_is_met_everywhere(axes):
    def f(*x):
        return 2.0 + sum((i + 1.0) * c for i, c in enumerate(x)) + math.prod(x)

    table = f(*np.ix_(*(axis.nodes for axis in axes)))
    rng = np.random.default_rng(0)
    point = [rng.uniform(-0.5 * axis.span, 0.5 * axis.span, 100) for axis in axes]
    np.testing.assert_allclose(interpolate(table, axes, point), f(*point), rtol=1e-5, atol=1e-5)


def test_a_circle_has_no_end_and_a_line_holds_its_ends():
    table = np.arange(8.0) ** 2
    for x in (-9.1, 0.3, 3.14, 40.0):
        turned = interpolate(table, (CIRCLE,), (np.array([x, x + 2.0 * math.pi]),))
        assert turned[0] == pytest.approx(turned[1], abs=1e-4)
    last_gap = interpolate(table, (CIRCLE,), (np.array([CIRCLE.nodes[-1] + 0.5 * CIRCLE.spacing]),))
    assert last_gap == pytest.approx(0.5 * (table[-1] + table[0]), rel=1e-5)
    table = np.arange(7.0)
    np.testing.assert_array_equal(interpolate(table, (LINE,), (np.array([-99.0, -3.0, 3.0, 99.0]),)), [0, 0, 6, 6])
