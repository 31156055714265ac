"""Directives for what the program prints: a command's --help, and the catalogue of effects as a table."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

ROOT = Path(__file__).resolve().parents[2]


class Help(Directive):
    """`.. help:: sysid fit`: what `python -m sysid fit --help` prints."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """A literal block; raises where the command fails, which ends the build."""
        words = self.arguments[0].split()
        environment = os.environ | {"COLUMNS": "100", "NO_COLOR": "1", "PYTHONPATH": str(ROOT), "TERM": "dumb"}
        command = [sys.executable, "-m", *words, "--help"]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=ROOT, check=False)
        if done.returncode:
            raise self.error(f"{' '.join(command)} failed: {done.stderr}")
        return [nodes.literal_block(done.stdout, done.stdout, language="text")]


class Catalogue(Directive):
    """`.. catalogue::`: the effects, each with its formula, parameters and look-alikes."""

    def run(self) -> list[nodes.Node]:
        """A table with one row an effect."""
        from docstrings import escaped

        from sysid import CATALOGUE

        lines = [".. list-table::", "   :header-rows: 1", "   :widths: 16 40 24 20", ""]
        lines += ["   * - name", "     - formula", "     - parameters [unit]", "     - often confused with"]
        for name, kind in CATALOGUE.items():
            about = kind.formula or (kind.__doc__ or "").strip().splitlines()[0]
            numbers = ", ".join(f"{p.name} [{p.unit}]" for p in kind().parameters.values())
            lines += [f"   * - ``{name}``", f"     - {escaped(about)}", f"     - {escaped(numbers)}"]
            lines.append(f"     - {escaped(', '.join(kind.confused))}".rstrip())
        box = nodes.container()
        self.state.nested_parse(StringList(lines, source="catalogue"), self.content_offset, box)
        return list(box.children)


def setup(app: Any) -> dict[str, bool]:
    """Both directives."""
    app.add_directive("help", Help)
    app.add_directive("catalogue", Catalogue)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
