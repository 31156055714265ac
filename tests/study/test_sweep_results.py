"""What a study keeps: estimates, runs, references and the time spent on unfinished populations."""

import pytest

from study.paper.presets import QUICK, SMOKE, Cell
from study.paper.reference_controllers import REFERENCES, Reference
from study.paper.runs import ESTIMATES, RUNS, Estimated, Run
from study.paper.sweep import Sweep, sweep_results
from sysid import InvalidInput

CURVE, SETTINGS = ((200, -3.5),), {"sac": {"steps": 1}}
RUN = Run(Cell("main", 5, 0.5, 1), 0, (1.785, 1.65), 0.26, (-1.25, -2.5), CURVE, SETTINGS, {"torch": "2"}, 7.5, (-3.0,))
REFERENCE = Reference("optimal", (2.1, 1.5), (2.0, 1.5), 1, (-1.0, -2.0), {"numpy": "2"}, 3.0)
ESTIMATED = Estimated("main", 5, 1, (1.785, 1.65), 0.5)


def test_what_went_in_comes_out_again(tmp_path):
    with sweep_results(tmp_path, SMOKE) as store:
        store.note_training(0, 12.5)
        assert store.training_seconds(0) == 12.5
        store.add(RUNS, [RUN], [0])
        store.add(REFERENCES, [REFERENCE])
        store.add(ESTIMATES, [ESTIMATED])
        assert store.training_seconds(0) == 0.0
    with sweep_results(tmp_path, SMOKE) as store:
        assert store.all(RUNS) == [RUN]
        assert store.all(REFERENCES) == [REFERENCE]
        assert Sweep(SMOKE, store).estimates() == {("main", 5, 1): (1.785, 1.65)}
        assert store.keys(RUNS) == {RUN.cell}


def test_a_folder_of_another_preset_is_refused(tmp_path):
    sweep_results(tmp_path, SMOKE).close()
    with pytest.raises(InvalidInput, match="preset 'smoke', expected 'quick'"):
        sweep_results(tmp_path, QUICK)
