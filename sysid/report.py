"""The report: one HTML page that opens without a network, pictures first."""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sysid.diagnose.answer import Diagnosis, Step
from sysid.diagnose.compare import Comparison, compare
from sysid.diagnose.held_out import HeldOutError
from sysid.diagnose.residual_torque import ResidualTorque, residual_torque
from sysid.effects import CATALOGUE
from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.logs import Log, split
from sysid.model import Model
from sysid.records import Record
from sysid.response import CHANNELS
from sysid.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 12_000
"""Samples of a log whose residual torque is drawn."""

UNITS = {"theta": "rad", "theta_dot": "rad/s"}
WORDS = {"theta": "angle", "theta_dot": "speed"}
MINUS, TIMES = "\N{MINUS SIGN}", "\N{MULTIPLICATION SIGN}"


class Picture(NamedTuple):
    """A figure as a data URI, what it shows in words, and whether it takes a whole column."""

    image: str
    caption: str
    wide: bool = True


@dataclass(frozen=True)
class Section:
    """Pictures under a heading, with sentences above them."""

    title: str
    sentences: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True)
class Table:
    """Rows under heads; the first column is words, the others are numbers. `note` stands below."""

    title: str
    heads: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True)
class Page:
    """All that the template is told."""

    title: str
    badge: str
    sentence: str
    numbers: tuple[str, ...]
    under: tuple[str, ...]
    sections: Sequence[Section]
    tables: Sequence[Table]
    lists: Mapping[str, Sequence[str]]
    settings: Mapping[str, str]
    warnings: tuple[str, ...] = field(default=())


def write_report(
    answer: Diagnosis | Comparison,
    records: Sequence[Record],
    path: str | PathLike[str],
    hold_out: float | None = None,
) -> None:
    """Write an answer as one self-contained HTML page: no script, no network, figures inside, light and dark.

    records    the log that the answer is about, all of it
    hold_out   as it was given to `diagnose`

    Raises InvalidInput where the records are not those of the answer, and where the file cannot be written.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sysid"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    html = environment.get_template("report.html.j2").render(page=page_of(answer, records, hold_out))
    try:
        Path(path).write_text(html, encoding="utf-8")
    except OSError as error:
        raise InvalidInput(f"cannot write {path}: {error.strerror}") from None


@singledispatch
def page_of(answer: Any, records: Sequence[Record], hold_out: float | None = None) -> Page:
    """What the page of an answer says. Raises InvalidInput for what has no page."""
    raise InvalidInput(f"no report of a {type(answer).__name__}: expected a Diagnosis or a Comparison")


# ---- a diagnosis -----------------------------------------------------------------------------------------------------


@page_of.register
def _(answer: Diagnosis, records: Sequence[Record], hold_out: float | None = None) -> Page:
    held_out = _held_out(answer, records, hold_out)
    models = (answer.base.model, answer.model) if answer.steps or answer.conventions else (answer.model,)
    compared = tuple(compare(m, held_out, answer.sensor) for m in models)
    shown = _head(records, MOST)
    torques = tuple(residual_torque(m, shown, answer.sensor) for m in models)
    found = torques[-1]
    sections = {
        "fall": _fall(answer),
        "rollout": _rollout(answer, models, held_out, found),
        "ranking": _ranking(answer),
        "torque": _torque(answer, torques, sum(len(r) for r in shown) < sum(len(r) for r in records)),
        "maps": _maps(compared),
    }
    order = ("fall", "torque", "rollout", "ranking", "maps") if answer.verdict == "unknown" else tuple(sections)
    mended = len(models) > 1
    return Page(
        title=f"sysid: {answer.verdict}",
        badge=answer.verdict,
        sentence=_sentence(answer.sentence),
        numbers=_pair(answer.base_error.ratio if mended else None, answer.error.ratio),
        under=tuple(_physical(answer.base_error if mended else None, answer.error)),
        sections=[s for name in order if (s := sections[name]).pictures],
        tables=[
            _parameters(answer),
            *_steps(answer),
            _horizons(compared),
            *_ruled_out(answer),
        ],
        lists={
            "What this motion cannot tell apart": [", ".join(g) for g in answer.not_identifiable],
            "What the fit says of itself": [answer.estimate.status, *answer.estimate.ambiguous],
            "The next experiment": _experiment(answer.next_experiment),
        },
        settings=_settings(answer.sensor, answer.held_out, records)
        | {
            "model": _described(answer.model),
            "fitted": f"{answer.estimate.n_readings:,} readings, {_horizon(answer.estimate)}",
            "diagnosed in": f"{answer.seconds:.1f} s",
        },
        warnings=tuple(f"A hand? No state of the joint explains {t}." for t in found.touched),
    )


def _held_out(answer: Diagnosis, records: Sequence[Record], hold_out: float | None) -> tuple[Record, ...]:
    """The records that no fit has seen. Raises InvalidInput where they are not among these."""
    held_out = split(records, hold_out)[1]
    if tuple(r.name for r in held_out) != answer.held_out:
        held_out = tuple(r for r in records if r.name in answer.held_out)
    if tuple(r.name for r in held_out) != answer.held_out:
        raise InvalidInput(
            f"the diagnosis held out {', '.join(answer.held_out)}, which these records do not: "
            "expected the records and the hold_out that it was given"
        )
    return held_out


def _head(records: Sequence[Record], most: int) -> tuple[Record, ...]:
    """The first samples of a log."""
    shown, left = [], most
    for record in records:
        if left > 0:
            shown.append(record.head(left))
            left -= len(record)
    return tuple(shown)


def _fall(answer: Diagnosis) -> Section:
    from sysid import report_figures as figures

    steps = (*answer.conventions, *answer.steps)
    caption = (
        "Error over windows of 1 s of rollouts that no fit has seen, each window's state refitted, in units of the sensor "
        "noise, which was found without any model: 1.0 is what a perfect model gets. Small dots: single windows."
    )
    title = "The error, step by step" if steps else "The error is the noise"
    if not steps and answer.verdict != "adequate":
        title = "The error"
    return Section(title, (), (_picture(figures.fall(answer), caption),))


def _rollout(answer: Diagnosis, models: Sequence[Model], held_out: Sequence[Record], found: ResidualTorque) -> Section:
    from sysid import report_figures as figures

    paths = figures.courses(models, held_out, answer.sensor)
    names = ("as it came", "mended") if len(models) > 1 else ("model",)
    caption = (
        "A typical stretch of what was held out, predicted from its refitted first state alone. Numbers: error in units of "
        "the sensor noise over this stretch; green band: 2 sd of the sensor noise."
    )
    return Section(
        "A rollout that no fit has seen",
        (),
        (_picture(figures.rollout(paths, answer.sensor, names, found.touched), caption),),
    )


def _ranking(answer: Diagnosis) -> Section:
    from sysid import report_figures as figures

    caption = (
        "The first round: every effect of the catalogue, by what it would explain. Effects in one row move the readings of "
        "this log alike. Dark: added in the end; light: significant then; grey: could be chance. p is corrected for "
        "the number of candidates; error: held-out, where the effect was refitted."
    )
    pictures = (_picture(figures.ranking(answer), caption),) if answer.ranking else ()
    return Section("Which effect explains the error?", (), pictures)


def _torque(answer: Diagnosis, torques: Sequence[ResidualTorque], cut: bool) -> Section:
    from sysid import report_figures as figures

    found, before = torques[-1], torques[0] if len(torques) > 1 else None
    left = answer.remaining
    depends_on = [n for n in (left.depends_on if left else ()) if n in found.binned]
    names = sorted(found.binned, key=lambda n: n not in depends_on)
    colours = "Blue: beyond the mended model; orange: beyond the model as it came." if before else ""
    sentences = [_sentence(f"{found}.")]
    if left is not None:
        on = " and ".join(left.depends_on) or "nothing that was tried"
        where = f", {left.where}" if left.where else ""
        sentences.insert(
            0, _sentence(f"{left.share:.0%} of the squared error is unexplained; it depends on {on}{where}.")
        )
    touched = " Yellow: what no state of the joint explains, a hand perhaps." if found.touched else ""
    time = (
        f"Torque that must act beyond the model for the log to have come about, with its 95 % band. {colours}{touched}"
        f"{f' The first {MOST:,} samples of the log.' if cut else ''}"
    )
    pictures = [_picture(figures.course(found, before), time)]
    for name in names:
        mark = name in depends_on
        share = found.explained.get(name, 0.0)
        says = f"Its mean over {name} predicts {share:.0%} of it on other rollouts." if found.present else ""
        pictures.append(
            _picture(
                figures.over(found, name, before, mark),
                f"Over {name}. {says}{' Yellow: where it lives.' if mark else ''}",
                wide=False,
            )
        )
    title = "The torque that no known effect explains" if answer.verdict == "unknown" else "Torque beyond the model"
    return Section(title, tuple(sentences), tuple(pictures))


def _maps(compared: Sequence[Comparison]) -> Section:
    from sysid import report_figures as figures

    titles = ("as it came", "mended") if len(compared) > 1 else ("",)
    sentences = [
        f"{name + ': ' if name else ''}{_sentence(c.sentence)}" for name, c in zip(titles, compared, strict=True)
    ]
    caption = "Torque that the held-out readings need beyond the model, by state; a dot: beyond 99 % of what noise does."
    picture = _picture(figures.maps([c.map for c in compared], titles), caption, wide=len(compared) > 1)
    return Section("Where the model fails", tuple(s[0].upper() + s[1:] for s in sentences), (picture,))


def _parameters(answer: Diagnosis) -> Table:
    parameters, sd, interval = answer.model.parameters, answer.estimate.sd, answer.estimate.interval()
    rows = []
    for name, value in answer.estimate.values.items():
        low, high = interval[name]
        known = math.isfinite(low) and math.isfinite(high)
        came = answer.base.values.get(name)
        rows.append(
            [
                name,
                _measured(value, sd[name]),
                f"{_rounded(low, sd[name])} to {_rounded(high, sd[name])}" if known else "not determined",
                _unit(parameters[name].unit),
                "" if came is None else _number(f"{came:.4g}"),
                "at its bound" if name in answer.estimate.at_bound else "",
            ]
        )
    heads = ("parameter", "value \N{PLUS-MINUS SIGN} sd", "95 % interval", "unit", "in the model as it came", "")
    return Table("The mended model" if answer.steps else "The model", heads, rows)


def _steps(answer: Diagnosis) -> Iterator[Table]:
    steps = (*answer.conventions, *answer.steps)
    if steps:
        rows = [_step(s, s in answer.conventions) for s in steps]
        yield Table("What was added", ("effect", "error before", "after", "p", "not told from", "formula"), rows)


def _step(step: Step, of_log: bool) -> list[str]:
    from sysid.report_figures import chance, times

    kind = CATALOGUE.get(step.effect)
    name = f"{step.effect} (how the log stamps torques)" if of_log else step.effect
    p = chance(step.p_value).removeprefix("p = ").removeprefix("p ")
    formula = kind.formula if kind is not None else ""
    return [name, times(step.error_before), times(step.error_after), p, ", ".join(step.alike[1:]), formula]


def _ruled_out(answer: Diagnosis) -> Iterator[Table]:
    rows = [
        [name, _number(f"{size['size']:.2g}"), _unit(size["unit"]), size["parameter"]]
        for name, size in sorted(answer.ruled_out.items())
        if math.isfinite(size["size"])
    ]
    if rows:
        note = "An effect of that size would have been found in 80 of 100 such logs, one after the other."
        yield Table("Ruled out above", ("effect", "size", "unit", "of"), rows, note)


def _experiment(found: Mapping[str, Any] | None) -> list[str]:
    """What to do next, in sentences."""
    if not found:
        return []
    said = [str(found.get("description") or found.get("kind") or "")]
    before, after, measure = found.get("before"), found.get("after"), found.get("measure")
    if after is not None:
        what = {"evidence": "Evidence (16 decide)", "interval": "Half width of the widest interval"}.get(
            str(measure), str(measure)
        )
        was = "" if before is None else f"{before:.3g} on this log, "
        said.append(f"{what}: {was}{after:.3g} expected of it.")
    if found.get("rollouts"):
        start = ", ".join(f"{a:.2f}" for a in dict.fromkeys(found.get("start") or ()))
        said.append(
            f"{found['rollouts']} rollouts, {found.get('seconds', 0.0):.3g} s in all, torque up to "
            f"{found.get('u_peak', math.nan):.3g} N m{f', from rest at {start} rad' if start else ''}."
        )
    return [_sentence(s) for s in said if s]


# ---- a comparison ----------------------------------------------------------------------------------------------------


@page_of.register
def _(answer: Comparison, records: Sequence[Record], hold_out: float | None = None) -> Page:
    causes = [_sentence(c.words[0].upper() + c.words[1:] + ".") for c in answer.causes]
    return Page(
        title="sysid: how far off, and where",
        badge="adequate" if answer.adequate else "off",
        sentence=_sentence(answer.sentence),
        numbers=_pair(None, answer.ratio),
        under=tuple(_physical(None, answer.one_second)),
        sections=tuple(_compared(answer)),
        tables=[_horizons((answer,))],
        lists={"What explains it together, the strongest first": causes, "Surprises": list(answer.surprises)},
        settings=_settings(answer.sensor, answer.records, records),
    )


def _compared(answer: Comparison) -> Iterator[Section]:
    from sysid import plotting
    from sysid import report_figures as figures

    def panel(draw: Callable[..., None], *given: Any) -> Figure:
        return figures.drawn(figures.NARROW, 2.9, lambda axes: draw(*given, axes))

    wide = figures.drawn(figures.WIDE, 3.2, lambda axes: plotting.errors(answer, axes))
    yield Section("How far off", (), (_picture(wide, "Error over windows of every length, the state refitted in each."),))
    yield Section(
        "The worst windows",
        (),
        tuple(_picture(figures.window(t), "", wide=False) for t in answer.worst),
    )
    band = "Torque that the readings need beyond the model, with its 99 % band."
    yield Section(
        "Where it fails",
        (),
        (
            _picture(figures.maps([answer.map], [""]), "By state; a dot: beyond 99 % of what noise does.", wide=False),
            *(_picture(panel(plotting.curve, c), f"Over {n}. {band}", wide=False) for n, c in answer.curves.items()),
        ),
    )
    yield Section(
        "What the residuals know",
        (),
        (
            _picture(panel(plotting.past_torque, answer), "A delay or a lag shows as a correlation.", wide=False),
            _picture(panel(plotting.whiteness, answer), "Of a perfect model they are white.", wide=False),
        ),
    )


# ---- parts of both ---------------------------------------------------------------------------------------------------


def _horizons(compared: Sequence[Comparison]) -> Table:
    """Errors over windows of every length, of one model or of two."""
    from sysid.report_figures import times

    heads, columns = ["error over"], []
    for name, found in zip(("as it came: ", "mended: ")[: len(compared)] if len(compared) > 1 else ("",), compared,
                           strict=True):  # fmt: skip
        for channel in found.one_second.ratios:
            heads += [f"{name}{WORDS[channel]} [{UNITS[channel]}]", f"{TIMES} noise"]
            columns += [
                [_number(f"{getattr(e, channel):.2g}") for e in found.errors.values()],
                [times(e.ratios[channel]) for e in found.errors.values()],
            ]
    rows = [[label, *(c[k] for c in columns)] for k, label in enumerate(compared[0].errors)]
    return Table("Errors by horizon", tuple(heads), rows, "Held out; the state of every window is refitted.")


def _pair(before: float | None, after: float) -> tuple[str, ...]:
    from sysid.report_figures import times

    return (times(after),) if before is None else (times(before), times(after))


def _physical(before: HeldOutError | None, after: HeldOutError) -> Iterator[str]:
    """The error of each channel in its unit."""
    for channel in after.ratios:
        was = "" if before is None else f"{getattr(before, channel):.2g} \N{RIGHTWARDS ARROW} "
        yield _number(f"{WORDS[channel]} {was}{getattr(after, channel):.2g} {UNITS[channel]}")


def _settings(sensor: Sensor, held_out: Sequence[str], records: Sequence[Record]) -> dict[str, str]:
    from importlib import metadata

    try:
        version = metadata.version("gapfinder")
    except metadata.PackageNotFoundError:
        version = "not installed"
    dt, n = records[0].dt, sum(len(r) for r in records)
    noise = [f"{WORDS[c]} {sd:.3g} {UNITS[c]}" for c in CHANNELS if (sd := getattr(sensor, c)) is not None]
    names = [r.name for r in records]
    settings = {
        "log": f"{len(records)} rollout{'s' * (len(records) != 1)}, {n:,} samples ({n * dt:.4g} s) at {1.0 / dt:.4g} Hz",
        "rollouts": _listed(names),
        "held out": _listed(held_out),
        "sensor noise": ", ".join(noise),
        "gapfinder": version,
    }
    notes = "; ".join(records.notes) if isinstance(records, Log) else ""
    return settings | ({"on reading": notes} if notes else {})


def _listed(names: Sequence[str], most: int = 12) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _described(model: Model) -> str:
    effects = ", ".join(e.name for e in model.effects) or "no effects"
    return f"{type(model.plant).__name__} with {effects}; {type(model.integrator).__name__}, steps of {model.dt:.4g} s"


def _horizon(estimate: Estimate) -> str:
    return "whole rollouts" if math.isinf(estimate.horizon) else f"windows of {estimate.horizon:g} s"


def _picture(figure: Figure, caption: str, wide: bool = True) -> Picture:
    """The figure as an SVG inside the page, without a background."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gapfinder", "path.simplify_threshold": 0.3}):
        figure.savefig(file, format="svg", transparent=True, dpi=150, metadata={"Date": None})
    return Picture("data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode(), caption.strip(), wide)


def _sentence(text: str) -> str:
    """A sentence as print would set it."""
    text = re.sub(r"^(adequate|missing|unknown|cannot tell): ", "", text.strip())
    text = re.sub(r"(?<![\w.])-(?=[\d.])", MINUS, text.replace("+-", "\N{PLUS-MINUS SIGN}"))
    return text[:1].upper() + text[1:]


def _number(text: str) -> str:
    return re.sub(r"(?<!\w)-|(?<=e)-", MINUS, text)


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _rounded(value: float, sd: float) -> str:
    """A number to two digits of its sd."""
    if not math.isfinite(sd) or sd <= 0.0 or not math.isfinite(value):
        return _number(f"{value:.4g}")
    places = min(1 - math.floor(math.log10(sd)), 12)
    return _number(f"{value:.{max(places, 0)}f}" if abs(value) < 1e6 else f"{value:.4g}")


def _measured(value: float, sd: float) -> str:
    spread = f"{sd:.1g}" if not math.isfinite(sd) or sd <= 0.0 else _rounded(sd, sd)
    return f"{_rounded(value, sd)} \N{PLUS-MINUS SIGN} {spread if math.isfinite(sd) else 'unknown'}"
