"""What a diagnosis says: data of one schema, a verdict that agrees with what it rests on, a text that reads well."""

from __future__ import annotations

import dataclasses
import json

import pytest

from sysid import (
    CATALOGUE,
)
from sysid.diagnosis.answer import SCHEMA, VERDICTS
from sysid.diagnosis.diagnose import POWER
from sysid.logs import split
from tests.sysid.planted import (
    DEPENDENCES,
    EVERY,
    SENSOR,
    logs,
    of,
    records_of,
    rod,
    truth,
)

KEYS = {
    "schema",
    "plant",
    "parameters",
    "noise",
    "held_out",
    "base_error",
    "error",
    "verdict",
    "steps",
    "conventions",
    "ranking",
    "remaining",
    "not_identifiable",
    "ruled_out",
    "touched",
    "next_experiment",
    "seconds",
}
STEP = {"effect", "class", "parameters", "error_before", "error_after", "p_value"}
RANKED = {"effect", "class", "score", "p_value", "error_after"}
NUMBER = {"value", "sd", "unit"}


@pytest.mark.parametrize("name", EVERY)
def test_the_answer_is_data_of_the_documented_schema(name: str) -> None:
    found = of(name)
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert set(data) == KEYS
    assert data["schema"] == SCHEMA
    assert data["plant"] == "RodPendulum"
    assert data["verdict"] in VERDICTS
    assert data["noise"] == {"theta": SENSOR.theta, "theta_dot": SENSOR.theta_dot}
    assert data["held_out"] == [r.name for r in split(records_of(name))[1]]
    assert data["base_error"] == found.base_error.ratio
    assert set(data["parameters"]) == set(found.estimate.names)
    assert all(set(p) == NUMBER for p in data["parameters"].values())
    for step in (*data["steps"], *data["conventions"]):
        assert set(step) == STEP
        assert step["class"][0] == step["effect"]
        assert all(set(p) == NUMBER for p in step["parameters"].values())
        for full, p in step["parameters"].items():
            assert data["parameters"][full] == p
    for ranked in data["ranking"]:
        assert set(ranked) == RANKED
        assert ranked["effect"] in CATALOGUE
        assert 0.0 <= ranked["p_value"] <= 1.0
    assert data["remaining"] is None or set(data["remaining"]) == {"share", "depends_on", "where"}
    assert all(isinstance(n, str) for group in data["not_identifiable"] for n in group)
    assert all(set(r) == {"parameter", "size", "unit"} for r in data["ruled_out"].values())
    assert data["seconds"] > 0.0


@pytest.mark.parametrize("name", EVERY)
def test_the_verdict_agrees_with_what_it_rests_on(name: str) -> None:
    found = of(name)
    assert (found.remaining is not None) == (found.verdict == "unknown")
    if found.verdict == "adequate":
        assert not found.steps
    if found.verdict in ("missing", "cannot tell"):
        assert found.steps
    if found.verdict != "cannot tell":
        assert found.next_experiment is None
    if found.remaining is not None:
        assert set(found.remaining.depends_on) <= DEPENDENCES
        assert 0.0 <= found.remaining.share <= 1.0
    chain = sorted((*found.steps, *found.conventions), key=lambda s: len(s.estimate.names))
    before = [found.base_error.ratio, *(s.error_after for s in chain)]
    assert [s.error_before for s in chain] == before[:-1]
    assert before[-1] == found.error.ratio
    assert {e.name for e in found.model.effects} == {s.effect for s in chain}
    assert found.best.estimate is found.estimate
    assert found.model is found.estimate.model


@pytest.mark.parametrize("name", EVERY)
def test_it_reads_well(name: str) -> None:
    found = of(name)
    assert found.sentence.startswith(f"{found.verdict}: ")
    assert found.sentence.endswith(".")
    assert "\n" not in found.sentence
    assert str(found).startswith(found.sentence)
    assert all(s.effect in str(found) for s in (*found.steps, *found.conventions))


@pytest.mark.parametrize("name", ["nothing", "viscous", "tilt"])
def test_what_the_motion_cannot_separate_is_always_named(name: str) -> None:
    groups = [set(g) for g in of(name).not_identifiable]
    assert {"m", "l", "torque_gain", "rotor_inertia"} in groups
    twins = {"viscous": {"viscous", "back_emf"}, "tilt": {"tilt", "angle_offset"}}
    if name in twins:
        assert twins[name] in groups
        assert set(of(name).steps[0].alike) == twins[name]
        assert of(name).verdict == "missing", "twins are one thing to every log of this kind"


def test_the_ranking_is_of_everything_visible_and_in_order() -> None:
    found = of("coulomb")
    names = [r.effect for r in found.ranking]
    assert len(names) == len(set(names))
    assert set(names) == set(CATALOGUE) - {"torque_gain", "rotor_inertia"}
    refitted = [r for r in found.ranking if r.error_after is not None]
    assert refitted == list(found.ranking[: len(refitted)]), "what was refitted stands before what was not"
    rest = [r.score for r in found.ranking[len(refitted) :]]
    assert rest == sorted(rest, reverse=True)
    assert found.ranking[0].error_after == pytest.approx(found.steps[0].error_after, rel=0.02)


def test_what_is_ruled_out_would_have_been_found() -> None:
    """At 1.3 times that size: p-values of a few effects, each by one screen."""
    from sysid.diagnose.search import Round
    from sysid.fit import fitted

    ruled = of("nothing").ruled_out
    assert {"viscous", "coulomb", "delay", "tilt"} <= set(ruled)
    assert "saturation" not in ruled
    for name in ("viscous", "tilt"):
        entry = ruled[name]
        hidden = truth(CATALOGUE[name](**{entry["parameter"]: 1.3 * entry["size"]}))
        training, _ = split(logs(hidden))
        now = Round.of(fitted(rod(), ("m", "l"), training, SENSOR), None)
        assert now.adjusted[name] < 0.05
        assert entry["size"] == pytest.approx(POWER * now.scores[name].sd[0], rel=0.1)


def test_an_error_that_rises_is_not_said_to_fall() -> None:
    found = of("coulomb")
    assert "falls from" in found.sentence
    worse = dataclasses.replace(found, base_error=found.error, error=found.base_error)
    assert "rises from" in worse.sentence and "falls" not in worse.sentence
