"""ops: the same function on every back end, chosen by the types of all arguments."""

import math

import casadi as ca
import numpy as np
import pytest
import torch

from sysid.physics import ops

X = [-2.3, -0.4, 0.7, 3.1]
UNARY = [ops.sin, ops.cos, ops.tanh, ops.exp, ops.abs, ops.floor, ops.wrap, lambda x: ops.sqrt(ops.abs(x))]
BINARY = [ops.minimum, ops.maximum, lambda x, y: ops.clip(x, y, 1.0), lambda x, y: ops.where(x > y, x, 2.0 * y)]


def evaluated(make, *values):
    """A CasADi expression of scalars, with numbers put in."""
    symbols = [ca.SX.sym(f"x{i}") for i in range(len(values))]
    return float(ca.Function("f", symbols, [make(*symbols)])(*values))


@pytest.mark.parametrize(("f", "more"), [*((f, ()) for f in UNARY), *((f, (0.5,)) for f in BINARY)])
def test_functions_agree(f, more):
    floats = [f(x, *more) for x in X]
    assert {type(v) for v in floats} == {float}
    np.testing.assert_allclose(f(np.array(X), *more), floats, rtol=1e-15)
    np.testing.assert_allclose(f(torch.tensor(X, dtype=torch.float64), *more).numpy(), floats, rtol=1e-14)
    np.testing.assert_allclose([evaluated(f, x, *more) for x in X], floats, rtol=1e-14)


@pytest.mark.parametrize("f", [ops.minimum, ops.maximum])
def test_a_number_beside_a_tensor_or_symbol_takes_its_back_end(f):
    tensor = torch.tensor(1.0, requires_grad=True)
    for number in (0.5, np.float64(0.5)):
        assert isinstance(f(number, tensor), torch.Tensor) and f(number, tensor).dtype == torch.float32
        assert isinstance(f(number, ca.SX.sym("x")), ca.SX)
    f(0.5 if f is ops.maximum else 2.0, tensor).backward()
    assert tensor.grad == 1.0


def test_wrap_keeps_the_angle_and_lands_in_one_turn():
    theta = np.linspace(-30.0, 30.0, 1001)
    wrapped = ops.wrap(theta)
    assert np.all((-math.pi <= wrapped) & (wrapped < math.pi))
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * theta), atol=1e-13)
    assert ops.wrap(math.pi) == -math.pi


def test_clip_without_limits_is_no_operation():
    x = ca.SX.sym("x")
    assert ops.clip(x, -math.inf, math.inf) is x


def test_numbers_are_told_from_symbols():
    assert all(map(ops.is_number, [1, 1.0, np.float32(1.0), np.ones(3), np.arange(3)]))
    assert not any(map(ops.is_number, [True, "1", None, ca.SX.sym("x"), ca.MX.sym("x"), torch.ones(3)]))
