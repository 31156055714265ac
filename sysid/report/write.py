"""The report: one HTML page that opens without a network, pictures first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial, singledispatch
from os import PathLike
from pathlib import Path
from typing import Any

import jinja2
from matplotlib.axes import Axes

from sysid.data.files import save_file
from sysid.data.record import is_part
from sysid.diagnosis.answer import MOST_SHOWN, Diagnosis, Step
from sysid.diagnosis.compare import Comparison, place_of_window
from sysid.diagnosis.contacts import OUTSIDE, Contact, contacts_sentence
from sysid.diagnosis.findings import chance, quantity, spaced_unit
from sysid.errors import InvalidInput
from sysid.physics.effects import CATALOGUE
from sysid.physics.model import Model
from sysid.report import figures, typesetting
from sysid.report.page import Page, Picture, Section, Table, horizon_table, physical, picture, report_settings


def write_report(answer: Diagnosis | Comparison, path: str | PathLike[str], command: str = "") -> None:
    """Write an answer as one self-contained HTML page: no script, no network, figures inside, light and dark.

    Parameters
    ----------
    answer : Diagnosis or Comparison
        It holds all that the page shows.
    path : path
        The file to write.
    command : str
        The command line that asked, where one did: the page ends with it.

    Raises
    ------
    InvalidInput
        For what has no page, and where the file cannot be written.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sysid.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    html = environment.get_template("report.html.j2").render(page=page_of(answer), command=command)
    save_file(Path(path), html)


def _panel(draw: Callable[[Axes], None], caption: str, wide: bool = False) -> Picture:
    """A picture of one panel."""
    return picture(figures.drawn(figures.WIDE if wide else figures.NARROW, 2.9, draw), caption, wide)


@singledispatch
def page_of(answer: Any) -> Page:
    """What the page of an answer says. Raises InvalidInput for what has no page."""
    raise InvalidInput(f"no report of a {type(answer).__name__}: expected a Diagnosis or a Comparison")


# ---- a diagnosis -----------------------------------------------------------------------------------------------------


@page_of.register
def _(answer: Diagnosis) -> Page:
    mended = answer.mended
    errors = (answer.base_error, answer.error) if mended else (answer.error,)
    contacts = _contacts(answer)
    sections = {
        "fall": _fall(answer),
        "rollout": _rollout(answer, contacts),
        "ranking": _ranking(answer),
        "torque": _torque(answer, contacts),
        "maps": _maps(answer.comparisons),
    }
    order = ("fall", "torque", "rollout", "ranking", "maps") if answer.remaining is not None else tuple(sections)
    return Page(
        title=f"sysid: {answer.verdict}",
        badge=answer.verdict,
        sentence=answer.finding,
        numbers=tuple(typesetting.typeset_multiple(e.ratio) for e in errors),
        under="times the sensor noise, on data that no fit has seen; 1.0 is a perfect model: " + physical(errors),
        sections=[s for name in order if (s := sections[name]).pictures or s.sentences],
        tables=[
            _parameters(answer),
            *_steps(answer),
            horizon_table([c.errors for c in answer.comparisons]),
            *_ruled_out(answer),
        ],
        lists={
            "Other effects": answer.other_effects,
            "What this motion cannot tell apart": [", ".join(group) for group in answer.not_identifiable],
            "What the fit says of itself": [answer.estimate.status, *answer.estimate.ambiguous],
            "The next experiment": str(answer.next_experiment or "").splitlines(),
        },
        settings=report_settings(answer.sensor, answer.records, answer.model.plant.quantities, answer.notes)
        | {
            "held out": typesetting.listed(answer.held_out),
            "model": _described(answer.model),
            "fitted": f"{answer.estimate.n_readings:,} readings",
            "diagnosed in": f"{answer.seconds:.1f} s",
        },
        turns=answer.model.plant.turns,
        warnings=tuple(_warnings(answer, contacts)),
    )


def _warnings(answer: Diagnosis, contacts: Sequence[Contact]) -> Iterator[str]:
    for doubt in answer.doubts:
        yield f"{typesetting.capital(doubt)}."
    if answer.contacts:
        yield f"{contacts_sentence(answer.contacts)} No fit has used them."
    if more := contacts[len(answer.contacts) :]:
        yield contacts_sentence(more)


def _contacts(answer: Diagnosis) -> tuple[Contact, ...]:
    """What the diagnosis left out, and what else no state of the joint explains."""

    def known(t: Contact) -> bool:
        return any(is_part(a.name, t.name) and a.t_begin < t.t_end and t.t_begin < a.t_end for a in answer.contacts)

    return (*answer.contacts, *(t for t in answer.residual_torques[-1].contacts if not known(t)))


def _described(model: Model) -> str:
    effects = ", ".join(model.effect_names) or "no effects"
    return f"{type(model.plant).__name__} with {effects}; {type(model.integrator).__name__}, steps of {model.dt:.4g} s"


def _fall(answer: Diagnosis) -> Section:
    caption = (
        f"Error over windows of {answer.error.window:g} s of rollouts that no fit has seen, each window's state "
        "refitted, in units of the sensor noise, which was found without any model: 1.0 is what a perfect model gets. "
        "Grey: single windows, at 0.1 where they err less."
    )
    steps = answer.steps or answer.conventions
    title = "The error, step by step" if steps else "The error"
    return Section(title, (), (picture(figures.fall(answer), caption),))


def _rollout(answer: Diagnosis, contacts: Sequence[Contact]) -> Section:
    ahead = answer.ahead
    far = "from its refitted first state alone" if math.isinf(ahead) else f"{ahead:g} s at a time"
    names = ("as it came", "mended") if answer.mended else ("model",)
    caption = (
        f"{answer.predictions[0].record}, predicted {far}: of the stretches of all {len(answer.unseen)} held-out "
        "rollouts the one whose error is the median. Numbers: error over this stretch in units of the sensor noise; "
        "green band: 2 sd of that noise."
    )
    drawn = figures.rollout_figure(answer.predictions, answer.sensor, names, contacts)
    return Section("A rollout that no fit has seen", (), (picture(drawn, caption),))


def _ranking(answer: Diagnosis) -> Section:
    caption = (
        "The first round: every effect of the catalogue, by what it would explain. Effects in one row move the "
        "readings of this log alike. Bold: added in the end; blue: significant; grey: could be chance. p is corrected "
        "for the number of candidates; error: held-out, where the effect was refitted."
    )
    drawn = [figures.ranking(answer, 9 if answer.steps else 6)] if answer.ranking else []
    return Section("Which effect explains the error?", (), tuple(picture(figure, caption) for figure in drawn))


def _torque(answer: Diagnosis, contacts: Sequence[Contact]) -> Section:
    torque, before = answer.residual_torques[-1], answer.residual_torques[0] if answer.mended else None
    whole = sum(map(len, answer.records)) <= MOST_SHOWN
    left, unknown = answer.remaining, answer.remaining is not None
    depends_on = left.depends_on if left else ()
    says, what = [torque.sentence], quantity("torque", torque.units)
    if answer.vibrates:
        says.append("The noise of the readings is taken as their scatter about the fit: the joint vibrates.")
    if answer.shared_error:
        says.append(f"It stands for this: {answer.shared_error_in_words}.")
    if answer.noisier:
        says.append(f"{typesetting.capital(answer.noisier)}.")
    if left is not None:
        says.insert(
            0, f"{left.share:.0%} of the {'mended ' if before else ''}model's squared error is more than noise."
        )
    caption = (
        f"{what.capitalize()} that must act beyond the model for the log to have come about, with its 99 % band."
        + (" Blue: beyond the mended model; orange: beyond the model as it came." if before else "")
        + (f" Yellow: what no state of the joint explains, perhaps {OUTSIDE}." if contacts else "")
        + ("" if whole else f" Of the first {MOST_SHOWN:,} samples.")
    )
    draw = partial(figures.over_time, torque, before=before, contacts=contacts)
    pictures = [_panel(draw, caption, wide=True)]
    for name in sorted(torque.binned, key=lambda n: n not in depends_on):
        share = torque.dependence.shares.get(name, 0.0)
        mark = name in depends_on and share > 0.05
        predicts = (
            f": functions of it tell {share:.0%} of it on other stretches." if torque.present and share > 0.05 else "."
        )
        caption = f"Over {quantity(name, torque.units)}{predicts}{' Yellow: where it is largest.' * mark}"
        pictures.append(_panel(partial(figures.binned_torque, torque, name, before=before, mark=mark), caption))
    title = f"The {what} that no known effect explains" if unknown else f"{what.capitalize()} beyond the model"
    return Section(title, tuple(says), tuple(pictures))


def _maps(compared: Sequence[Comparison]) -> Section:
    titles = ("As it came", "Mended") if len(compared) > 1 else ("",)
    says = [f"{title}: {c.sentence}" if title else c.sentence for title, c in zip(titles, compared, strict=True)]
    torques = [c.torque for c in compared if c.torque is not None]
    pictures: tuple[Picture, ...] = ()
    if len(torques) == len(compared) and any(t.map.significant.any() for t in torques):
        what = quantity("torque", torques[0].units).capitalize()
        caption = f"{what} that the held-out readings need beyond the model, by state; a dot: beyond 99 % of chance."
        pictures = (picture(figures.maps(torques, titles), caption, wide=len(compared) > 1),)
    return Section("Where the model fails", tuple(says), pictures)


def _parameters(answer: Diagnosis) -> Table:
    parameters, sd, interval = answer.model.parameters, answer.estimate.sd, answer.estimate.interval()
    rows = []
    for name, value in answer.estimate.values.items():
        low, high = (typesetting.rounded(end, sd[name]) for end in interval[name])
        came = f"{answer.base.values[name]:.4g}" if name in answer.base.values else ""
        rows.append(
            [
                name,
                typesetting.measured(value, sd[name]),
                f"{low} to {high}" if math.isfinite(sd[name]) else "",
                spaced_unit(parameters[name].unit).strip(),
                *([typesetting.typeset(came)] if answer.mended else []),
                "at its bound" if name in answer.estimate.at_bound else "",
            ]
        )
    came_heads = ("as it came, refitted",) if answer.mended else ()
    heads = ("parameter", f"value {typesetting.PLUS_MINUS} sd", "95 % interval", "unit", *came_heads, "")
    return Table("The mended model" if answer.mended else "The model", heads, rows, text_columns=(0, 3, len(heads) - 1))


def _steps(answer: Diagnosis) -> Iterator[Table]:
    if steps := figures.in_order(answer):
        heads = ("effect", "error before", "after", "by chance", "not told from", "formula")
        rows = [_step(s, s in answer.conventions) for s in steps]
        yield Table("What was added", heads, rows, text_columns=(0, 4, 5))


def _step(step: Step, of_log: bool) -> list[str]:
    kind = CATALOGUE.get(step.effect)
    return [
        f"{step.effect} (how the log stamps torques)" if of_log else step.effect,
        typesetting.typeset_multiple(step.error_before),
        typesetting.typeset_multiple(step.error_after),
        chance(step.p_value),
        ", ".join(step.indistinguishable[1:]),
        kind.formula.replace("-", typesetting.MINUS) if kind is not None else "",
    ]


def _ruled_out(answer: Diagnosis) -> Iterator[Table]:
    rows = [
        [name, typesetting.typeset(f"{size['size']:.2g}"), spaced_unit(size["unit"]).strip(), size["parameter"]]
        for name, size in sorted(answer.ruled_out.items())
        if math.isfinite(size["size"])
    ]
    if rows:
        note = "Each of these, alone and of that size, would have been found in 80 of 100 such logs."
        yield Table("Ruled out above", ("effect", "size", "unit", "of"), rows, note, text_columns=(0, 2, 3))


# ---- a comparison ----------------------------------------------------------------------------------------------------


@page_of.register
def _(answer: Comparison) -> Page:
    return Page(
        title="sysid: how far off, and where",
        badge="adequate" if answer.adequate else "off",
        sentence=answer.sentence,
        numbers=(typesetting.typeset_multiple(answer.ratio),),
        under="times the sensor noise over windows of 1 s; 1.0 is a perfect model: " + physical((answer.one_second,)),
        sections=tuple(_compared(answer)),
        tables=[horizon_table((answer.errors,))],
        lists={
            "What explains it, the strongest first": [c.description for c in answer.causes],
            "What a perfect model would not show": answer.surprises,
        },
        settings=report_settings(answer.sensor, answer.records, answer.units, answer.notes),
        turns=answer.units["theta"] == "rad",
    )


def _compared(answer: Comparison) -> Iterator[Section]:
    caption = "Error over windows of every length, the state refitted in each."
    yield Section("How far off", (), (_panel(partial(figures.errors, answer), caption, wide=True),))
    worst = zip(answer.worst, map(place_of_window, answer.one_second.worst), strict=True)
    pictures = tuple(picture(figures.window_figure(window), where, wide=False) for window, where in worst)
    yield Section("The worst windows", (), pictures, small=True)
    if (torque := answer.torque) is None:
        return
    says = (
        f"{quantity('torque', torque.units).capitalize()} that must act beyond the model, with its 99 % band; "
        "on the map a dot: beyond 99 %.",
    )
    states = picture(figures.maps([torque], [""]), "By state.", wide=False)
    curves = [
        _panel(partial(figures.binned_torque, torque, name), f"Over {quantity(name, torque.units)}.")
        for name in torque.binned
        if name != "time"
    ]
    in_time = _panel(partial(figures.over_time, torque), "Over time.", wide=True)
    yield Section("Where it fails", says, (states, *curves, in_time))
    white = _panel(
        partial(figures.autocorrelation_panel, answer), "Those of a right model, beside a random torque, are white."
    )
    yield Section("What the innovations know", (), (white,))
