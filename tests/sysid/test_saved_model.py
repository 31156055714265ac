"""model.json: what goes out comes back exactly, and what is no model is refused in one sentence."""

import dataclasses
import json
import math

import numpy as np
import pytest

import sysid
from study.paper.protocol import paper_model
from sysid.estimation.saved_model import MODEL_SCHEMA, from_dict, to_dict


def same(a, b):
    """Whether two parts hold the same numbers, bit for bit."""
    assert type(a) is type(b)
    for field in dataclasses.fields(a):
        x, y = getattr(a, field.name), getattr(b, field.name)
        assert dict(x) == dict(y) if field.name == "bounds" else x == y, field.name


def assert_same_model(a, b):
    same(a.plant, b.plant)
    same(a.integrator, b.integrator)
    assert (a.dt, a.u_max, len(a.effects)) == (b.dt, b.u_max, len(b.effects))
    for x, y in zip(a.effects, b.effects, strict=True):
        same(x, y)


def test_a_model_comes_back_exactly(plant, effect, integrator, tmp_path):
    model = sysid.Model(plant, (effect,), integrator, dt=1.0 / 3.0, u_max=math.pi)
    sysid.save(model, tmp_path / "model.json")
    assert_same_model(sysid.load_model(tmp_path / "model.json"), model)


def test_bounds_settings_and_infinities_come_back(tmp_path):
    plant = sysid.RodPendulum(m=7.0, bounds={"m": (0.1, 9.0), "g": (0.0, math.inf)})
    delay = sysid.Delay(T=0.45, longest=0.5)
    model = sysid.Model(plant, (delay,), sysid.SemiImplicitEuler(substeps=3, theta_dot_max=8.0))
    sysid.save(model, tmp_path / "model.json")
    back = sysid.load(tmp_path / "model.json")
    assert_same_model(back.model, model)
    assert back.free == ("m", "l", "delay.T")
    assert back.estimate is None
    assert "Infinity" not in (tmp_path / "model.json").read_text()


def records():
    truth = sysid.Model(sysid.RodPendulum(m=1.2, l=0.9), (sysid.Viscous(0.05),), dt=0.02)
    rng = np.random.default_rng(0)
    u = rng.uniform(-2.0, 2.0, (2, 150))
    return sysid.Sensor(0.003, 0.05).measure(sysid.simulate(truth, u, [3.0, 3.3], [0.0, 0.0]), rng)


@pytest.mark.parametrize("names", [("m", "l"), ("viscous.b", "m")])
def test_an_estimate_comes_back_exactly(names, tmp_path):
    model = sysid.Model(sysid.RodPendulum(), (sysid.Viscous(0.01),), dt=0.02)
    estimate = sysid.fit(model, records(), parameters=names)
    sysid.save(estimate, tmp_path / "model.json")
    back = sysid.load(tmp_path / "model.json")
    assert_same_model(back.model, estimate.model)
    assert back.free == back.estimate.names == names
    for field in {f.name for f in dataclasses.fields(estimate)} - {"model"}:
        np.testing.assert_array_equal(getattr(back.estimate, field), getattr(estimate, field), field)
    assert str(back.estimate) == str(estimate)


def test_what_is_not_determined_stays_so(tmp_path):
    """An infinite variance and whole rollouts survive the way through JSON, which has no infinity."""
    model = sysid.Model(sysid.RodPendulum(m=1.2, l=0.9), dt=0.02)
    estimate = sysid.Estimate(
        model, ("m", "l"), np.diag([math.inf, 1e-4]), {"theta": 0.003}, False, "so so", math.nan, 99, "by hand"
    )
    sysid.save(estimate, tmp_path / "model.json")
    back = sysid.load(tmp_path / "model.json").estimate
    np.testing.assert_array_equal(back.covariance, estimate.covariance)
    assert math.isnan(back.cost)
    assert back.sensor is None
    assert not back.success


def good():
    return to_dict(sysid.Model(sysid.RodPendulum(), (sysid.Viscous(0.1),)))


def changed(*path_and_value):
    *path, last, value = path_and_value
    data = json.loads(json.dumps(good()))
    at = data
    for key in path:
        at = at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return data


WRONG = {
    "another version": (changed("schema", "gapfinder/model/9"), MODEL_SCHEMA),
    "another answer": (changed("schema", "gapfinder/diagnosis/1"), MODEL_SCHEMA),
    "no schema": (changed("schema", None), "no model of ours"),
    "a list": ([1, 2], "no model of ours"),
    "no plant": (changed("plant", None), "no 'plant'"),
    "unknown plant": (changed("plant", "name", "Cartpole"), "expected one of RodPendulum"),
    "unknown integrator": (changed("integrator", "name", "Magic"), "expected one of RK4"),
    "unknown effect": (changed("effects", 0, "name", "viscious"), "did you mean viscous"),
    "effect of a user": (changed("effects", 0, "name", "magnet"), "or one of your own, whose file is given with --eff"),
    "unknown parameter": (changed("effects", 0, "parameters", "c", {"value": 1.0}), "'c'"),
    "unknown setting": (changed("effects", 0, "settings", "depth", 3), "'depth'"),
    "no value": (changed("plant", "parameters", "m", "value", None), "no 'value'"),
    "text for a number": (changed("plant", "parameters", "m", "value", "heavy"), "expected a number"),
    "out of bounds": (changed("plant", "parameters", "m", "value", -3.0), "out of bounds"),
    "wrong bounds": (changed("plant", "parameters", "m", "bounds", [3.0]), "expected [low, high]"),
    "text for a bound": (changed("plant", "parameters", "m", "bounds", ["a", 3.0]), "expected a number"),
    "no dt": (changed("dt", None), "no 'dt'"),
    "text for dt": (changed("dt", "fast"), "expected a number"),
    "zero dt": (changed("dt", 0), "dt = 0"),
    "settings a list": (changed("effects", 0, "settings", []), "expected an object"),
    "covariance of nan": (changed("estimate", {"covariance": [[math.nan] * 3] * 3}), "covariance holds NaN"),
    "a number of 400 digits": (
        changed("plant", "parameters", "m", "value", 10**400),
        "expected a number of at most 1e+150",
    ),
    "substeps for ever": (changed("integrator", "settings", "substeps", math.inf), "expected a whole number"),
    "substeps true": (changed("integrator", "settings", "substeps", True), "expected a whole number"),
    "half a substep": (changed("integrator", "settings", "substeps", 1.5), "substeps"),
    "text for substeps": (changed("integrator", "settings", "substeps", "two"), "substeps"),
    "unknown free name": (changed("free", ["m", "mass"]), "'mass'"),
    "effects no list": (changed("effects", {"name": "viscous"}), "expected a list"),
    "effect a word": (changed("effects", ["viscous"]), "no 'name'"),
    "estimate a word": (changed("estimate", "good"), "expected an object"),
    "estimate empty": (changed("estimate", {}), "no 'covariance'"),
    "covariance too small": (changed("estimate", {"covariance": [[1.0]]}), "expected 3 rows"),
    "covariance ragged": (changed("estimate", {"covariance": [[1.0], 2.0]}), "square"),
}


@pytest.mark.parametrize(("data", "message"), WRONG.values(), ids=WRONG.keys())
def test_what_is_no_model_is_refused(data, message, tmp_path):
    (tmp_path / "wrong.json").write_text(json.dumps(data))
    with pytest.raises(sysid.InvalidInput) as refused:
        sysid.load(tmp_path / "wrong.json")
    said = str(refused.value)
    assert said.startswith("wrong.json")
    assert message in said
    assert "\n" not in said


@pytest.mark.parametrize("text", ["", "{", "model", "\x00\xff", "[" * 100_000])
def test_what_is_no_json_is_refused(text, tmp_path):
    (tmp_path / "wrong.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(sysid.InvalidInput, match=r"wrong\.json is not JSON"):
        sysid.load(tmp_path / "wrong.json")


def test_files_that_cannot_be_read_or_written(tmp_path):
    with pytest.raises(sysid.InvalidInput, match="is a folder"):
        sysid.load(tmp_path)
    with pytest.raises(sysid.InvalidInput, match="cannot write"):
        sysid.save(paper_model(), tmp_path / "absent" / "model.json")


def test_what_has_no_name_of_ours_is_not_saved():
    class Acrobot(sysid.RodPendulum):
        pass

    with pytest.raises(sysid.InvalidInput, match="Acrobot cannot be saved"):
        to_dict(sysid.Model(Acrobot()))
    with pytest.raises(sysid.InvalidInput, match="array"):
        to_dict(sysid.Model(sysid.RodPendulum(m=np.array([1.0, 2.0]))))


def test_only_a_model_or_an_estimate_is_saved(tmp_path):
    class Answer:
        estimate = model = paper_model()

    with pytest.raises(sysid.InvalidInput, match="a Answer, whose `estimate` is one: expected a Model or an Estimate"):
        sysid.save(Answer(), tmp_path / "model.json")
    assert not list(tmp_path.iterdir())


def test_the_schema_is_the_documented_one():
    data = good()
    assert list(data) == ["schema", "plant", "effects", "integrator", "dt", "u_max", "free", "estimate"]
    assert data["plant"]["parameters"]["l"] == {"value": 1.0, "unit": "m"}
    assert data["effects"] == [
        {"name": "viscous", "parameters": {"b": {"value": 0.1, "unit": "N m s/rad"}}, "settings": {}}
    ]
    assert from_dict(data).free == ("m", "l", "viscous.b")
