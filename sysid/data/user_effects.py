"""A user's own effects: a Python file whose classes join the catalogue, and are checked before anything is fitted."""

from __future__ import annotations

import math
import sys
from os import PathLike
from pathlib import Path
from types import ModuleType

import casadi
import numpy as np

from sysid.data.files import path_of, read_file
from sysid.errors import LONGEST_SHOWN, InvalidInput, described, is_real
from sysid.physics.candidates import candidates_for
from sysid.physics.effects import CATALOGUE, Actuator, Effect, JointEffect
from sysid.physics.model import Model
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Extent
from sysid.physics.plants import PointMassPendulum

EXTENT = Extent(dt=0.02, duration=5.0, u_max=1.0)
THETA = np.array([0.3, 1.7, math.pi, 3.1, 5.9])
THETA_DOT = np.array([0.0, -2.1, 0.0, 3.7, 0.4])
U = (0.6, -0.9, 0.2)


def load_effects(path: str | PathLike[str]) -> tuple[str, ...]:
    """Run a user's Python file; the effects that it registers with @sysid.register join the catalogue.

    Every effect is tried at its neutral value and at its probes, with NumPy arrays and with CasADi symbols.

    Parameters
    ----------
    path : path
        A Python file. It is executed: load only what you trust.

    Returns
    -------
    tuple of str
        The names of its effects.

    Raises
    ------
    InvalidInput
        In one sentence, where the file cannot be run, registers nothing, or holds an effect that raises, gives no
        finite number, differs between arrays and symbols, changes the motion at its neutral value or has none.
    """
    path = path_of(path)
    read_file(path, "a Python file with effects")
    before = dict(CATALOGUE)
    module = f"{__name__}:{path.resolve()}"
    for name in [n for n, kind in CATALOGUE.items() if kind.__module__ == module]:
        del CATALOGUE[name]  # the file was loaded before, and may have changed
    try:
        run_file(path.resolve(), module)
        names = tuple(name for name, kind in CATALOGUE.items() if kind.__module__ == module)
        if not names:
            raise InvalidInput(f"{path.name} holds no effect: expected a class with @sysid.register before it")
        for name in names:
            check_effect(CATALOGUE[name], path.name)
    except BaseException:
        CATALOGUE.clear()
        CATALOGUE.update(before)
        raise
    return names


def run_file(path: Path, name: str) -> ModuleType:
    """Execute a user's file as a module of that name, and leave no __pycache__ beside it.

    Raises InvalidInput, in one sentence, where the file raises.
    """
    module = sys.modules[name] = ModuleType(name)  # dataclasses look their module up
    module.__file__ = str(path)
    try:
        exec(compile(path.read_bytes(), path, "exec", dont_inherit=True), module.__dict__)
    except InvalidInput as error:
        raise InvalidInput(f"{path.name}: {error}") from None
    except SyntaxError as error:
        raise InvalidInput(f"{path.name}, line {error.lineno}: {error.msg}") from None
    except BaseException as error:
        raise blamed(error) or InvalidInput(f"{path.name} raises {_described(error)}") from None
    return module


def blamed(error: BaseException) -> InvalidInput | None:
    """An InvalidInput that names the line of a user's file that raised the error; None if it came from elsewhere."""
    traceback, refusal = error.__traceback__, None
    while traceback is not None:
        code = traceback.tb_frame
        if code.f_globals.get("__name__", "").startswith(f"{__name__}:"):
            place = f"{Path(code.f_code.co_filename).name}, line {traceback.tb_lineno}"
            refusal = InvalidInput(f"{place} raises {_described(error)}")
        traceback = traceback.tb_next
    return refusal


def _described(error: BaseException) -> str:
    try:
        message = " ".join(str(error).split())
    except BaseException:
        message = ""
    return f"{type(error).__name__}: {message[:LONGEST_SHOWN]}" if message else type(error).__name__


def check_effect(kind: type[Effect], source: str) -> None:
    """Raise InvalidInput, with the effect's name and source, where it cannot be simulated, fitted or screened."""
    try:
        with np.errstate(all="ignore"):
            problem = _problem(kind)
    except InvalidInput as error:
        problem = str(error)
    except BaseException as error:
        problem = str(blamed(error) or f"it raises {_described(error)}")
    if problem:
        raise InvalidInput(f"effect {kind.name!r} of {source}: {problem}")


def _problem(kind: type[Effect]) -> str:
    tried = candidates_for(kind, EXTENT)
    if not tried or not tried[0].magnitudes:
        return "no parameter has a neutral value, at which the effect changes nothing: give one, as neutral=0.0"
    plain = Model(PointMassPendulum(m=1.0, l=0.5), dt=EXTENT.dt)
    still = _moved(plain)
    for alternative in (tried[k] for k in sorted({0, len(tried) // 2, len(tried) - 1})):  # formulas fail at the ends
        for e in (alternative.neutral, *alternative.probes):
            torque = _torque(plain, e)
            if not _fits(torque):
                return f"torque returns {_shown(torque)}: expected a number or an array of the state's shape"
            numbers = _moved(plain.with_effect(e))
            if not np.all(np.isfinite(numbers)):
                return f"at {_numbers(e)} it gives numbers that are not finite"
            symbols = _moved_symbols(plain.with_effect(e))
            if not np.allclose(numbers, symbols, rtol=1e-9, atol=1e-9):
                return f"at {_numbers(e)} arrays and CasADi disagree: use the functions of sysid.ops, and no if"
            if e is alternative.neutral and not np.allclose(numbers, still, rtol=1e-9, atol=1e-9):
                return f"at its neutral value, {_numbers(e)}, it changes the motion"
    return ""


def _torque(model: Model, e: Effect) -> object:
    """What an effect that is a torque returns as such, at as many states as THETA has; 0 for any other effect."""
    if isinstance(e, Actuator):
        return e.torque(np.full(THETA.shape, U[0]), THETA, THETA_DOT)
    if isinstance(e, JointEffect):
        return e.torque(model.joint(THETA, THETA_DOT, 0.0, np.full(THETA.shape, U[0])))
    return 0.0


def _fits(value: object) -> bool:
    """Whether a value is a number, or an array of numbers that has one for all states or one for each."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "biuf" and value.shape in ((), (1,), THETA.shape)
    return is_real(value) or isinstance(value, np.bool_)


def _shown(value: object) -> str:
    return f"an array of shape {value.shape}" if isinstance(value, np.ndarray) else described(value)


def _numbers(e: Effect) -> str:
    return ", ".join(f"{name} = {float(p.value):.4g}" for name, p in e.parameters.items())


def _moved(model: Model) -> Array:
    """States and readings (3, 4, K) after each command of U, from K states at once."""
    rows = _path(model, THETA, THETA_DOT)
    return np.array([[np.broadcast_to(np.asarray(v, dtype=float), THETA.shape) for v in row] for row in rows])


def _moved_symbols(model: Model) -> Array:
    """What `_moved` gives, computed by CasADi with the parameters as symbols."""
    theta, theta_dot = casadi.SX.sym("theta"), casadi.SX.sym("theta_dot")
    p = {name: casadi.SX.sym(name) for name in model.parameters}
    rows = _path(model.with_parameters(p), theta, theta_dot)
    flat = casadi.vertcat(*(casadi.SX(v) for row in rows for v in row))
    function = casadi.Function("moved", [theta, theta_dot, casadi.vertcat(*p.values())], [flat])
    values = [float(q.value) for q in model.parameters.values()]
    columns = [np.asarray(function(a, b, values)).ravel() for a, b in zip(THETA, THETA_DOT, strict=True)]
    return np.stack(columns, axis=-1).reshape(len(rows), -1, len(THETA))


def _path(model: Model, theta: Value, theta_dot: Value) -> list[tuple[Value, ...]]:
    """theta, theta_dot, and what the sensors show of them, after each command of U."""
    drives = model.drives(U, theta)
    sensing, inner = model.sensing(theta, theta_dot), model.inner_rest(theta)
    rows = []
    for k in range(len(U)):
        theta, theta_dot, inner = model.move_with_inner(theta, theta_dot, inner, next(drives), k * model.dt)
        reading, sensing = model.read(theta, theta_dot, sensing, (k + 1) * model.dt)
        rows.append((theta, theta_dot, *reading))
    return rows
