"""The work behind a model of the history: its fit, where it fails, what it is missing, and the report.

    python -m sysid.web.work SESSION_FOLDER NUMBER [--next] [EFFECTS.py]

It runs beside the server, writes each answer as a file when it is known, and says in progress.json what it does.
"""

from __future__ import annotations

import logging
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sysid.cli.command_options import ModelOptions, OnLog
from sysid.cli.commands import LogAndModel
from sysid.data.files import whole, write_whole
from sysid.data.json_file import plain
from sysid.data.record import Record, in_a_row, is_part
from sysid.data.user_effects import blamed, load_effects
from sysid.diagnosis.add import add
from sysid.diagnosis.answer import Diagnosis
from sysid.diagnosis.compare import Comparison, compare
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.findings import chance, fitted_numbers, spaced_unit
from sysid.diagnosis.ranked import Ranked
from sysid.diagnosis.residual_torque import ResidualTorque, residual_torque
from sysid.diagnosis.search_settings import DEFAULT
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.saved_model import load, save
from sysid.export.mjcf import to_mjcf
from sysid.export.prediction_table import predictions
from sysid.export.urdf import to_urdf
from sysid.physics.effects import CATALOGUE
from sysid.planning.next_experiment import limits_of, next_experiment
from sysid.report.typesetting import measured
from sysid.web.own_effect import effects_file
from sysid.web.script import begun_with
from sysid.web.session import Answer, Session

ONE_STEP = replace(DEFAULT, steps=1)
"""One addition at a time: the next one is chosen by whoever looks at the page."""


class Progress(logging.Handler):
    """Keeps what is being done in a file, and what was noted on the way."""

    def __init__(self, session: Session, number: int) -> None:
        super().__init__()
        self.session, self.number = session, number
        self.part, self.notes, self.began = "fitting", list[str](), time.time()

    def emit(self, record: logging.LogRecord) -> None:
        """Take up one message: notes are kept, what is being done is shown until the next."""
        if record.levelno >= logging.INFO:
            self.notes.append(record.getMessage())
        else:
            self.show(record.getMessage())

    def show(self, text: str = "") -> None:
        """Write what is being done."""
        self.session.write(self.number, Answer.PROGRESS, {"part": self.part, "text": text, "began": self.began})

    def enter(self, part: str) -> None:
        self.part = part
        self.show()


class Work:
    """One model of the history, worked on until all its answers are there."""

    def __init__(self, session: Session, number: int, progress: Progress, effects: Path | None) -> None:
        self.session, self.number, self.progress, self.effects = session, number, progress, effects
        self.folder, self.state = session.of(number), session.state.settings_of(number)
        self.node = self.state.nodes[number]

    @cached_property
    def task(self) -> LogAndModel:
        """The log, its noise and the model to begin with: the one before, where there is one."""
        start = self.state.start
        known = self.number if self.session.has(self.number, Answer.MODEL) else self.node.parent
        if known is not None:
            start = ModelOptions(model=self.session.of(known) / Answer.MODEL)
        return LogAndModel.of(OnLog(log=self.state.log, start=start))

    def run(self) -> None:
        """Everything that is not there yet, in the order in which a page shows it."""
        parts = (
            ("fitting", Answer.MODEL, self._fit),
            ("writing it for simulators", Answer.EXPORTED, self._export),
            ("looking where it fails", Answer.FAILS, self._fails),
            ("testing effects", Answer.EFFECTS, self._effects),
            ("writing the report", Answer.REPORT, self._report),
        )
        for part, file, do in parts:
            if not self.session.has(self.number, file):
                self.progress.enter(part)
                do()

    @cached_property
    def estimate(self) -> Estimate:
        return self._estimate_of(self.number)

    @cached_property
    def comparison(self) -> Comparison:
        """How far it is off, and where."""
        return compare(self.estimate, self.task.held_out, self.task.sensor)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What it lacks next."""
        t = self.task
        return diagnose(self.estimate, t.log, t.sensor, self.state.log.hold_out, settings=ONE_STEP)

    def _fit(self) -> None:
        task = self.task
        if self.node.parent is None:
            estimate = task.fitted()
            self.session.write(self.number, Answer.BEGUN, begun_with(task.model, task.names, self.effects))
        else:
            before, hold_out = self._estimate_of(self.node.parent), self.state.log.hold_out
            estimate = add(before, self.node.added, task.log, task.measured, hold_out).estimate
        save(estimate, self.folder / Answer.MODEL)

    def _export(self) -> None:
        """The model for simulators, what their languages cannot say, and the user's own effects that it has."""
        sentences = {}
        if own_effects := self.state.own_effects(self.number):
            write_whole(self.folder / Answer.OWN_EFFECTS, effects_file(own_effects, self.effects))
        for name, export in ((Answer.MJCF, to_mjcf), (Answer.URDF, to_urdf)):
            try:
                exported = export(self.estimate.model)
                exported.save(self.folder / name)
                sentences[str(name)] = list(exported.sentences)
            except InvalidInput as error:
                sentences[str(name)] = [str(error)]
        self.session.write(self.number, Answer.EXPORTED, sentences)

    def _fails(self) -> None:
        task, model, compared = self.task, self.estimate.model, self.comparison
        torque = residual_torque(model, task.log, task.sensor)
        data = compared.to_dict() | {
            "ratio": plain(compared.ratio),
            "quantities": dict(model.plant.quantities),
            "command_unit": model.command_unit,
            "turns": model.plant.turns,
            "at_angle": model.at_angle,
            "reach": self._reach(torque),
            "u_max": float(max(np.max(np.abs(r.u)) for r in task.log)),
            "torque": torque.to_dict(series=False),
            "parameters": _told(fitted_numbers(self.estimate)),
            "at_bound": list(self.estimate.at_bound),
            "status": self.estimate.status,
            "notes": self.progress.notes,
            "rollouts": _places(task.log, task.held_out),
        }
        self._series(torque)
        self.session.write(self.number, Answer.FAILS, data)

    def _reach(self, torque: ResidualTorque) -> float:
        """How far the residual torque reaches, or that of a model before reached: all are drawn on one scale."""
        reach = float(np.quantile(np.abs(np.concatenate([r.d for r in torque.records])), 0.998))
        before = self.session.read(self.node.parent, Answer.FAILS)
        return reach if before is None else max(reach, before["reach"])

    def _series(self, torque: ResidualTorque) -> None:
        """The log beside its predictions, and the motion in it: all samples, rollout after rollout on one axis."""
        task, model = self.task, self.estimate.model
        table = predictions(model, task.log, task.sensor, torque)
        shifts = [place["shift"] for place in _places(task.log, task.held_out)]
        series: dict[str, Any] = table | {f"{c}_read": table[c] for c in CHANNELS if c in table}
        series |= {
            "t": table["t"] + np.repeat(shifts, [len(r.t) for r in task.log]),
            "theta": model.plant.place(np.concatenate([record.theta for record in torque.records])),
            "theta_dot": np.concatenate([record.theta_dot for record in torque.records]),
        }
        with whole(self.folder / Answer.SERIES) as file:
            np.savez(file, **series)

    def _effects(self) -> None:
        diagnosis = self.diagnosis
        chosen = [s.effect for s in (*diagnosis.conventions, *diagnosis.steps)]
        rows = [_row(r, diagnosis) for r in diagnosis.ranking if r.fit is not None]
        shown = {row["effect"] for row in rows}
        data = {
            "verdict": diagnosis.verdict,
            "finding": diagnosis.finding,
            "next": chosen,
            "rows": sorted(rows, key=lambda row: row["effect"] not in chosen),
            "others": [_named(r) for r in diagnosis.ranking if r.effect not in shown],
            "ruled_out": {} if chosen else diagnosis.ruled_out,
            "doubts": list(diagnosis.doubts),
            "remarks": list(diagnosis.remarks),
            "not_identifiable": [list(group) for group in diagnosis.not_identifiable],
        }
        self.session.write(self.number, Answer.EFFECTS, data)

    def _report(self) -> None:
        """What the model lacks; of one that the next step would mend, where it fails."""
        from sysid.report.write import write_report

        answer = self.comparison if self.diagnosis.mended else self.diagnosis
        write_report(answer, self.folder / Answer.REPORT)

    def experiment(self) -> None:
        """What to play next: what tells indistinguishable effects apart, or else what narrows the widest interval."""
        diagnosis = self.session.read(self.number, Answer.EFFECTS)
        best = diagnosis["rows"][0] if diagnosis and diagnosis["next"] else None
        rivals = [best["effect"], *best["alike"][:1]] if best and best["alike"] else []
        limits = limits_of(self.task.log, self.estimate.model)
        planned = next_experiment(self.estimate, rivals, limits, self.task.sensor, self.task.training)
        if planned.u.size:
            planned.write_csv(self.folder / Answer.NEXT)
        self.session.write(self.number, Answer.PLANNED, {"sentence": str(planned)})

    def _estimate_of(self, number: int) -> Estimate:
        saved = load(self.session.of(number) / Answer.MODEL).estimate
        if saved is None:
            raise InvalidInput(f"{Answer.MODEL} of model {number} holds no fit: expected one that the workbench wrote")
        return saved


def _told(numbers: Mapping[str, Mapping[str, Any]]) -> list[dict[str, str]]:
    """Fitted numbers, as a page shows them."""
    return [
        {"name": name, "said": measured(n["value"], n["sd"]), "unit": spaced_unit(n["unit"]).strip()}
        for name, n in numbers.items()
    ]


def _places(records: Sequence[Record], held_out: Sequence[Record]) -> list[dict[str, Any]]:
    """Where each rollout lies on one axis of time [s], with a gap between them, and which of it no fit has seen."""
    places = []
    for r, begin in zip(records, in_a_row([r.t for r in records]).tolist(), strict=True):
        shift = begin - float(r.t[0])
        parts = [h for h in held_out if is_part(h.name, r.name)]
        unseen = [[float(h.t[0]) + shift, float(h.t[-1]) + shift] for h in parts]
        places.append({"name": r.name, "shift": shift, "unseen": unseen})
    return places


def _named(candidate: Ranked) -> dict[str, Any]:
    kind = CATALOGUE[candidate.effect]
    return {
        "effect": candidate.effect,
        "words": kind.label,
        "formula": kind.formula,
        "chance": chance(candidate.p_value),
        "alike": list(candidate.indistinguishable[1:]),
    }


def _row(candidate: Ranked, diagnosis: Diagnosis) -> dict[str, Any]:
    """What a row says of an effect that was refitted."""
    step = next((s for s in (*diagnosis.steps, *diagnosis.conventions) if s.effect == candidate.effect), None)
    numbers = candidate.parameters if step is None else fitted_numbers(step.estimate, candidate.effect)
    return _named(candidate) | {
        "alike": list((candidate if step is None else step).indistinguishable[1:]),
        "sizes": _told(numbers),
        "explained": candidate.explained,
        "error": plain(candidate.error_after),
        "chance": chance(candidate.p_value if step is None else step.p_value),
        "torque": plain(candidate.torque),
    }


def main(arguments: Sequence[str]) -> int:
    """The work on one model; where it cannot be done, error.json says why in one sentence."""
    session, number = Session(Path(arguments[0])), int(arguments[1])
    effects = next((Path(a) for a in arguments[2:] if a != "--next"), None)
    progress, logger = Progress(session, number), logging.getLogger("sysid")
    logger.addHandler(progress)
    logger.setLevel(logging.DEBUG)
    progress.show("reading the log")
    try:
        if effects is not None:
            load_effects(effects)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            for effect in session.state.own:
                effect.register()
            work = Work(session, number, progress, effects)
            work.run()
            if "--next" in arguments:
                progress.enter("planning the next experiment")
                work.experiment()
    except Exception as error:
        known = error if isinstance(error, InvalidInput) else blamed(error)
        said = str(known or f"the {progress.part} failed with {type(error).__name__}: {error}")
        session.write(number, Answer.ERROR, {"part": progress.part, "message": said})
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
