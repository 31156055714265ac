"""The rooms of a package as floors: a room imports from those above it and never back."""

import ast
from collections.abc import Iterator, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]


def against_the_order(package: str, floors: Sequence[str]) -> list[str]:
    """Every import of the package that goes against the order of its floors, those inside functions and for types too;
    and every room that is on no floor."""
    violations = []
    for path in sorted((ROOT / package).rglob("*.py")):
        room = path.relative_to(ROOT / package).parts[0].removesuffix(".py")
        if room in ("__init__", "__main__"):
            continue
        if room not in floors:
            violations.append(f"{path.relative_to(ROOT)} is in no known room: expected one of {', '.join(floors)}")
            continue
        above = floors[: floors.index(room) + 1]
        violations += [
            f"{path.relative_to(ROOT)} imports {name}"
            for name in imported(path)
            if name.startswith(f"{package}.") and name.split(".")[1] not in above
        ]
    return violations


def imported(path: Path) -> Iterator[str]:
    """The modules that a file imports, with what it takes from them."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def circle(package: str) -> list[str]:
    """Modules of a package that import each other in a circle, inside functions and for types too, if any."""
    files = {_module(path): path for path in (ROOT / package).rglob("*.py")}
    above = {name: {_owner(target, files) for target in imported(path)} - {name, ""} for name, path in files.items()}
    try:
        tuple(TopologicalSorter(above).static_order())
    except CycleError as error:
        return list(error.args[1])
    return []


def _module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _owner(name: str, files: Mapping[str, Path]) -> str:
    """The module of the package that something is taken from; "" for another package."""
    return next((module for module in (name, name.rpartition(".")[0]) if module in files), "")
