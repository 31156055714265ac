"""How a command line of this distribution runs: one of its commands, errors as one sentence, exit codes.

What a command says goes through `logging`, under the name of its module. Notes and answers are INFO, and become lines
of the standard output; what a long computation is doing is DEBUG, and becomes one line of a terminal that the next one
replaces.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import reduce, wraps
from operator import or_
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from sysid.errors import InvalidInput, printable
from sysid.version import version

PACKAGES = ("sysid", "policies", "study")
"""The loggers that a command line listens to."""
OPTIONS = ConstructorRegistry()
"""How a command line reads options: `with OPTIONS` while it does so."""
PLAIN_NAMES = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
"""Options are called as their fields, whichever group they stand in."""


@OPTIONS.primitive_rule
def _left_out(asked: PrimitiveTypeInfo) -> Any:
    """Of an option that is None where it is left out, what it holds else: "None" is none of its choices."""
    kinds = [kind for kind in get_args(asked.type) if kind is not NoneType]
    if asked.type_origin not in (Union, UnionType) or len(kinds) == len(get_args(asked.type)):
        return None
    rest: Any = reduce(or_, kinds)
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(rest, asked.markers))
    if not isinstance(spec, PrimitiveConstructorSpec):
        return spec
    return replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: [] if value is None else spec.str_from_instance(value),
    )


class Terminal(logging.Handler):
    """Writes what is said: errors to the standard error, notes and answers to the standard output.

    Control characters that came out of a file are shown as escapes.
    """

    busy = False
    """Whether the terminal shows what is being done."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message; a reader who has gone away raises BrokenPipeError."""
        text = printable(record.getMessage())
        if self.busy:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
            self.busy = False
        if record.levelno >= logging.INFO:
            print(text, file=sys.stderr if record.levelno >= logging.WARNING else sys.stdout, flush=True)
        elif sys.stderr.isatty():
            print(f"{text} ...", end="", file=sys.stderr, flush=True)
            self.busy = True


@contextmanager
def terminal() -> Iterator[logging.Logger]:
    """A logger whose messages a terminal shows, as those of the packages, until this ends."""
    handler, loggers = Terminal(), [logging.getLogger(name) for name in PACKAGES]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.DEBUG)
    try:
        yield logging.getLogger(__name__)
    finally:
        for logger in loggers:
            logger.removeHandler(handler)
            logger.setLevel(logging.NOTSET)


def called(module: str) -> str:
    """The name of the program: the entry point that was called, or `module`, as in "python -m policies"."""
    name = Path(sys.argv[0]).name
    return name if name.startswith("gapfinder-") else module


def entry_point(main: Callable[[Sequence[str]], int]) -> Callable[..., int]:
    """Make an entry point of a function of the command line's arguments, by default those of the process.

    It answers --version, and ends without a word where whoever read its output has gone away. Nobody waits for the rest
    then, which is no error of the user's: the exit code is 1, as Python's own is.
    """

    @wraps(main)
    def run(arguments: Sequence[str] | None = None) -> int:
        given = sys.argv[1:] if arguments is None else list(arguments)
        try:
            try:
                if given != ["--version"]:
                    return main(given)
                print(version())
                return 0
            finally:
                sys.stdout.flush()  # here, and not when the interpreter ends, where nothing could be caught
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1

    return run


def answer(
    commands: Mapping[str, Callable[..., Any]],
    run: Callable[[Any], None],
    prog: str,
    about: str,
    arguments: Sequence[str],
) -> int:
    """Read one of the commands and run it; returns the exit code of `carry_out`."""
    with OPTIONS:
        command = tyro.extras.subcommand_cli_from_dict(
            dict(commands), prog=prog, description=about, args=arguments, config=PLAIN_NAMES
        )
    return carry_out(command, run)


def answer_one(options: type[Any], run: Callable[[Any], None], prog: str, arguments: Sequence[str]) -> int:
    """Read the options of a program without commands, and run it; returns the exit code of `carry_out`."""
    with OPTIONS:
        given = tyro.cli(options, prog=prog, args=arguments, config=PLAIN_NAMES)
    return carry_out(given, run)


def carry_out(command: Any, run: Callable[[Any], None]) -> int:
    """Run a command; returns the exit code: 0 answered, 2 bad input, 130 stopped.

    run loads what is heavy, when it is called: numpy's library has its threads set by then.
    """
    # small matrices: threads would only wait for each other
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    with terminal() as logger:
        try:
            run(command)
            sys.stdout.flush()
        except KeyboardInterrupt:
            logger.error("stopped")
            return 130
        except BrokenPipeError:  # whoever read the answer has seen enough: `entry_point`
            raise
        except BaseException as error:
            logger.error(f"error: {_refusal(error)}")
            return 2
    return 0


def _refusal(error: BaseException) -> InvalidInput:
    """The sentence on what cannot be used; raises the error again where it is none of the user's."""
    if isinstance(error, InvalidInput):
        return error
    if isinstance(error, MemoryError):
        return InvalidInput("this needs more memory than there is: expected a shorter log, or smaller numbers")
    from sysid.data.user_effects import blamed

    refusal = blamed(error)
    if refusal is None:
        raise error
    return refusal
