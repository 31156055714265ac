"""Elementary functions for floats, NumPy arrays, CasADi symbols and torch tensors.

Physics is written once with these. The back end follows from the types of *all* arguments, so that a float limit beside
a CasADi state gives a CasADi expression. Plain floats give plain floats, because a NumPy scalar times a tensor would
lose the gradient. torch is looked up among the modules already loaded and never imported here.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import cache
from types import ModuleType
from typing import Any, TypeAlias

import casadi
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value: TypeAlias = Any
"""A float, an ndarray, a CasADi SX/MX/DM or a torch tensor."""

_CASADI = (casadi.SX, casadi.MX, casadi.DM)


def _module_for(*types: type) -> Any:
    """torch, casadi or numpy for values of these types; None if all are plain numbers."""
    torch = sys.modules.get("torch")
    if torch is not None and any(issubclass(t, torch.Tensor) for t in types):
        return torch
    if any(issubclass(t, _CASADI) for t in types):
        return casadi
    return np if any(issubclass(t, np.ndarray) for t in types) else None


_back_end: Callable[..., Any] = cache(_module_for)
"""Looking at the types anew would cost as much as the functions themselves on the few numbers of one state."""


def is_number(value: Value) -> bool:
    """Whether `value` holds plain numbers (float, int, real ndarray), not symbols or tensors."""
    if isinstance(value, np.ndarray):
        return bool(np.issubdtype(value.dtype, np.number))
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _unary(name: str, x: Value) -> Value:
    back_end = _back_end(type(x))
    if back_end is None:
        return float(getattr(np, name)(x))
    return getattr(back_end, "fabs" if name == "abs" and back_end is casadi else name)(x)


def sin(x: Value) -> Value:
    """sin(x), x [rad]."""
    return _unary("sin", x)


def cos(x: Value) -> Value:
    """cos(x), x [rad]."""
    return _unary("cos", x)


def tanh(x: Value) -> Value:
    """Hyperbolic tangent."""
    return _unary("tanh", x)


def exp(x: Value) -> Value:
    """Exponential."""
    return _unary("exp", x)


def sqrt(x: Value) -> Value:
    """Square root, x >= 0."""
    return _unary("sqrt", x)


def abs(x: Value) -> Value:
    """Absolute value."""
    return _unary("abs", x)


def floor(x: Value) -> Value:
    """Largest whole number <= x."""
    return _unary("floor", x)


def _as_tensors(torch: ModuleType, values: tuple[Value, ...]) -> list[Value]:
    """All values as tensors, of the type and on the device of the first that is one.

    Numbers are created on that device: a graph of a GPU may not wait for a copy from the host.
    """
    like = next(v for v in values if isinstance(v, torch.Tensor))
    options = {"dtype": like.dtype, "device": like.device}

    def as_tensor(v: Value) -> Value:
        if isinstance(v, torch.Tensor):
            return v
        return torch.full((), v, **options) if isinstance(v, float | int) else torch.as_tensor(v, **options)

    return [as_tensor(v) for v in values]


def _binary(name: str, casadi_name: str, x: Value, y: Value) -> Value:
    back_end = _back_end(type(x), type(y))
    if back_end is np:
        return getattr(np, name)(x, y)
    if back_end is None:
        return float(getattr(np, name)(x, y))
    if back_end is casadi:
        return getattr(casadi, casadi_name)(x, y)
    return getattr(back_end, name)(*_as_tensors(back_end, (x, y)))


def minimum(x: Value, y: Value) -> Value:
    """The smaller of x and y, element by element."""
    return _binary("minimum", "fmin", x, y)


def maximum(x: Value, y: Value) -> Value:
    """The larger of x and y, element by element."""
    return _binary("maximum", "fmax", x, y)


def clip(x: Value, low: Value, high: Value) -> Value:
    """x limited to [low, high]; an infinite pair of limits returns x untouched."""
    if isinstance(low, float) and isinstance(high, float) and low == -math.inf and high == math.inf:
        return x
    return minimum(maximum(x, low), high)


def where(condition: Value, x: Value, y: Value) -> Value:
    """x where the condition holds, else y; both are evaluated, so both must be finite."""
    back_end = _back_end(type(condition), type(x), type(y))
    if back_end is np:
        return np.where(condition, x, y)
    if back_end is None:
        return x if condition else y
    if back_end is casadi:
        return casadi.if_else(condition, x, y)
    torch = back_end
    if not isinstance(condition, torch.Tensor):
        condition = torch.as_tensor(condition)
    if not any(isinstance(v, torch.Tensor) for v in (x, y)):
        x = torch.full((), float(x), device=condition.device)
    return torch.where(condition, *_as_tensors(torch, (x, y)))


def stack(values: Sequence[Value]) -> Value:
    """Values (...,) side by side along a new last axis, (..., I); CasADi symbols as a column (I, 1)."""
    back_end = _back_end(*map(type, values))
    if back_end is casadi:
        return casadi.vertcat(*values)
    if back_end is None or back_end is np:
        return np.stack(np.broadcast_arrays(*values), -1)
    torch = back_end
    return torch.stack(torch.broadcast_tensors(*_as_tensors(torch, tuple(values))), -1)


def as_type_of(like: Value, *values: Value) -> tuple[Value, ...]:
    """The values as tensors of the type and on the device of `like` if that is a tensor; else as they are."""
    back_end = _back_end(type(like))
    if back_end in (None, np, casadi):
        return values
    return tuple(_as_tensors(back_end, (like, *values))[1:])


def wrap(theta: Value) -> Value:
    """theta [rad] shifted by whole turns into [-pi, pi), as Gymnasium's Pendulum does."""
    return theta - 2.0 * math.pi * floor((theta + math.pi) / (2.0 * math.pi))
