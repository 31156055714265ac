"""A user's own effect out of a formula that is parsed and never run as code.

    tau = -a * exp(-((theta - c) / w) ** 2)        c = 2, 3, 4; w = 0.3

Names that are no variable are the effect's numbers: those at which 0 the formula vanishes are sizes, which a fit begins
at nothing; the others are shapes, of which values to try are given.
"""

from __future__ import annotations

import ast
import keyword
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.data.user_effects import check_effect
from sysid.errors import InvalidInput, excerpt
from sysid.physics import ops
from sysid.physics.effects import CATALOGUE, Effect, Joint, JointEffect, register
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter

VARIABLES = {"theta": "rad", "theta_dot": "rad/s", "t": "s", "drive": "N m"}
"""What a formula may depend on: the joint's angle and speed, the time, and the drive torque."""
FUNCTIONS: dict[str, tuple[Callable[..., Value], int]] = {
    "sin": (ops.sin, 1),
    "cos": (ops.cos, 1),
    "tanh": (ops.tanh, 1),
    "exp": (ops.exp, 1),
    "sqrt": (ops.sqrt, 1),
    "abs": (ops.abs, 1),
    "wrap": (ops.wrap, 1),
    "minimum": (ops.minimum, 2),
    "maximum": (ops.maximum, 2),
}
OPERATIONS: dict[type[ast.AST], Callable[..., Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
SIZE_BOUNDS = (-1e6, 1e6)
"""What the size of a formula may be."""
LONGEST_FORMULA = 400
"""Characters of a formula, at most."""
DEEPEST = 24
"""Levels to which its terms stand in each other, at most."""
MOST_NUMBERS = 6
"""Names of a formula that are no variable, at most: each is a number to fit."""
LARGEST_POWER = 8
"""The largest exponent."""
MODULE = f"{__name__}:made"
"""The module that effects made here say they come from: it is no file."""


@dataclass(frozen=True)
class OwnEffect:
    """What a user wrote: a name, a formula for the torque [N m], and values to try the shapes at."""

    name: str
    formula: str
    shapes: str = ""

    def checked(self) -> type[Effect]:
        """Its class; raises InvalidInput where it cannot be simulated, fitted or told from one of the catalogue."""
        kind = made(self)
        if CATALOGUE.get(kind.name, kind).__module__ != MODULE:
            raise InvalidInput(f"an effect named {kind.name!r} is in the catalogue: give yours another name")
        check_effect(kind, "your formula")
        return kind

    def register(self) -> None:
        """Put it into the catalogue, in the place of an older one of the name."""
        kind = self.checked()
        CATALOGUE.pop(kind.name, None)
        register(kind)

    def source(self) -> str:
        """The same effect as a class in Python."""
        tree = parsed_formula(self.formula)
        numbers = [
            f"    {name}: float = sysid.parameter({', '.join(f'{k}={v!r}' for k, v in declared.items())})"
            for name, declared in _numbers(tree, self.shapes).items()
        ]
        written = ast.unparse(_Qualified().visit(ast.fix_missing_locations(tree)))
        title = "".join(part.capitalize() for part in self.name.split("_"))
        return "\n".join(
            ["@sysid.register", "@dataclasses.dataclass(frozen=True, eq=False)", f"class {title}(sysid.JointEffect):",
             f'    name = "{self.name}"', *numbers, "", "    def torque(self, joint):", f"        return {written}", ""]
        )  # fmt: skip


def effects_file(own_effects: Sequence[OwnEffect], effects: Path | None) -> str:
    """A Python file of a user's effects, behind those of the file that the command line named."""
    before = [f"sysid.load_effects({str(effects.resolve())!r})"] if effects else []
    return "\n".join(["import dataclasses", "", "import sysid", "", *before, "", *(o.source() for o in own_effects)])


def parsed_formula(formula: str) -> ast.expr:
    """The formula as a tree of what is allowed; raises InvalidInput, with what is not."""
    text = formula.partition("=")[2] if formula.strip().startswith("tau") and "=" in formula else formula
    if not text.strip() or len(text) > LONGEST_FORMULA:
        raise InvalidInput(
            f"the formula has {len(text)} characters: expected 1 to {LONGEST_FORMULA}, as in -b * theta_dot"
        )
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InvalidInput(f"{excerpt(text.strip())} is no formula: expected one as in -b * theta_dot") from None
    _check(tree, DEEPEST)
    return tree


def _check(tree: ast.AST, depth: int) -> None:
    if depth == 0:
        raise InvalidInput("the formula is nested too deep: expected fewer brackets")
    for operand in _understood(tree)[1]:
        _check(operand, depth - 1)


def _understood(tree: ast.AST) -> tuple[Callable[..., Value], Sequence[ast.AST]]:
    """What a part of a formula does with its operands, and these; raises InvalidInput for what is not allowed."""
    match tree:
        case ast.Constant(value=bool() | complex()):
            pass
        case ast.Constant(value=int() | float() as number) if abs(number) < 1e9:
            return lambda: float(number), ()
        case ast.Name(id=name) if name not in FUNCTIONS and len(name) <= 24 and not name.startswith("_"):
            return lambda: name, ()
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATIONS:
            return OPERATIONS[type(op)], (operand,)
        case ast.BinOp(left=left, op=ast.Pow(), right=right) if power := _power(right):
            return lambda base: base**power, (left,)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATIONS:
            return OPERATIONS[type(op)], (left, right)
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            if len(args) == FUNCTIONS[name][1]:
                return FUNCTIONS[name][0], args
    raise InvalidInput(
        f"{excerpt(ast.unparse(tree))} is not understood: expected numbers, {', '.join(VARIABLES)}, names of your own, "
        f"+ - * /, ** with a whole number up to {LARGEST_POWER}, and {', '.join(FUNCTIONS)}"
    )


def _power(tree: ast.AST) -> int:
    """A whole number that a power may have; 0 for anything else."""
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        return -_power(tree.operand)
    number = tree.value if isinstance(tree, ast.Constant) else None
    return number if type(number) is int and 0 < number <= LARGEST_POWER else 0


def value(tree: ast.AST, names: Mapping[str, Value]) -> Value:
    """What a formula is worth, whatever its names hold: floats, arrays, CasADi's symbols or tensors."""
    if isinstance(tree, ast.Name):
        return names[tree.id]
    function, operands = _understood(tree)
    return function(*(value(operand, names) for operand in operands))


def made(effect: OwnEffect) -> type[Effect]:
    """The class of an effect that a user wrote. Raises InvalidInput for a name or a formula that cannot be one's."""
    if (
        not effect.name.isidentifier()
        or keyword.iskeyword(effect.name)
        or not effect.name.islower()
        or len(effect.name) > 40
    ):
        raise InvalidInput(f"{excerpt(effect.name)} is no name: expected small letters and _, as in magnet_beside")
    tree = parsed_formula(effect.formula)
    numbers = _numbers(tree, effect.shapes)

    def torque(self: Any, joint: Joint) -> Value:
        return value(tree, {n: getattr(joint, n) for n in VARIABLES} | {n: getattr(self, n) for n in numbers})

    fields = [(name, Any, parameter(**declared)) for name, declared in numbers.items()]
    said = {"name": effect.name, "formula": f"tau = {ast.unparse(tree)}"}
    namespace = {**said, "torque": torque, "__module__": MODULE, "__doc__": said["formula"]}
    return make_dataclass("Own", fields, bases=(JointEffect,), frozen=True, eq=False, namespace=namespace)


def _numbers(tree: ast.AST, values: str) -> dict[str, dict[str, Any]]:
    """The names of a formula that are no variable, and what declares each as a parameter."""
    symbols = dict.fromkeys(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and n.id not in FUNCTIONS)
    names = [n for n in symbols if n not in VARIABLES]
    if len(names) > MOST_NUMBERS:
        raise InvalidInput(f"the formula has {len(names)} numbers: expected {MOST_NUMBERS} at most")
    for name in names:
        if hasattr(JointEffect, name) or name in ("bounds", "joint"):
            raise InvalidInput(f"{name!r} cannot be a number's name: expected another, as a or tau_c")
    shapes = _values(values)
    sizes = _sizes(tree, names, shapes)
    if not sizes:
        raise InvalidInput(
            "no number of the formula makes it vanish at 0: expected a size before it, as in a * sin(theta)"
        )
    size = {"default": 0.0, "unit": "1", "bounds": SIZE_BOUNDS, "neutral": 0.0}
    return {
        n: size if n in sizes else
        {"default": shapes[n][0], "unit": "1", "bounds": _bounds(shapes[n]), "probe": shapes[n]}
        for n in names
    }  # fmt: skip


def _sizes(tree: ast.AST, numbers: Sequence[str], shapes: Mapping[str, Sequence[float]]) -> tuple[str, ...]:
    """The numbers in which the formula is linear and at which 0 it vanishes: one alone, or several together.

    Raises InvalidInput where others have no values to try.
    """
    rng = np.random.default_rng(0)
    seen: dict[str, Value] = {n: rng.uniform(0.5, 3.0, 20) for n in (*VARIABLES, *numbers)}

    def at(names: Sequence[str], times: float) -> Value:
        with np.errstate(all="ignore"):
            return np.asarray(value(tree, seen | {n: times * seen[n] for n in names}))

    free = [n for n in numbers if n not in shapes]
    linear = [n for n in free if np.allclose(at([n], 2.0) - at([n], 1.0), at([n], 1.0) - at([n], 0.0), rtol=1e-6)]
    alone = [n for n in linear if not np.any(at([n], 0.0))]
    together = linear if linear and not np.any(at(linear, 0.0)) else []
    sizes = tuple(alone[:1] or together)
    if sizes and (missing := [n for n in free if n not in sizes]):
        one = missing[0]
        variables = ", ".join(VARIABLES)
        raise InvalidInput(
            f"{', '.join(missing)}: expected one of the variables {variables}, or values to try, as in {one} = 0.1, 0.5"
        )
    return sizes


def _values(text: str) -> dict[str, tuple[float, ...]]:
    """{name: values} of "c = 2, 3; w = 0.3"."""
    shapes = {}
    for line in (part.strip() for part in text.replace("\n", ";").split(";") if part.strip()):
        name, equals, numbers = (part.strip() for part in line.partition("="))
        try:
            tried = tuple(float(n) for n in numbers.replace(",", " ").split())
        except ValueError:
            tried = ()
        if not equals or not 0 < len(tried) <= 12 or not all(abs(v) < 1e6 for v in tried):
            raise InvalidInput(f"{excerpt(line)}: expected a shape and values to try, as in w = 0.2, 0.5")
        shapes[name] = tried
    return shapes


def _bounds(values: Sequence[float]) -> tuple[float, float]:
    """What a shape may be: around what is tried; a shape that is tried above 0 alone stays there."""
    low, high = min(values), max(values)
    room = 2.0 * max(high - low, abs(high), abs(low), 0.1)
    return (low / 20.0 if low > 0.0 else low - room), high + room


class _Qualified(ast.NodeTransformer):
    """Names as a class's method writes them."""

    def visit_Name(self, node: ast.Name) -> ast.AST:
        owner = "sysid.ops" if node.id in FUNCTIONS else "joint" if node.id in VARIABLES else "self"
        return ast.parse(f"{owner}.{node.id}", mode="eval").body


def suggested(comparison: Mapping[str, Any] | None) -> OwnEffect:
    """A form for the residual torque of a model, by what it depends on and where it is strongest."""
    torque = {} if comparison is None else comparison["torque"]
    on = (torque.get("depends_on") or ["time"])[0]
    if on == "theta":
        over = torque["over"][on]
        mean, edges = [abs(v or 0.0) for v in over["mean"]], over["edges"]
        peak, width = edges[mean.index(max(mean))], (edges[-1] - edges[0]) / 12.0
        near = ", ".join(f"{peak + k * width:.2g}" for k in (-1, 0, 1))
        formula = "(a + b * wrap(theta - c)) * exp(-(wrap(theta - c) / w) ** 2)"
        return OwnEffect("my_effect", formula, f"c = {near}; w = {width / 2:.2g}, {2 * width:.2g}")
    if on == "theta_dot":
        return OwnEffect("my_effect", "-a * tanh(theta_dot / v) - b * theta_dot", "v = 0.05, 0.5")
    if on == "torque":
        return OwnEffect("my_effect", "a * drive + b * drive ** 3")
    periods = ", ".join(f"{math.tau * k:.3g}" for k in (0.1, 0.5, 1, 2))
    return OwnEffect("my_effect", "a * sin(w * t) + b * cos(w * t)", f"w = {periods}")
