"""The same tasks on a Ray cluster of two nodes: workers and nodes may go, the numbers stay."""

import contextlib
import dataclasses
import io
import os
import signal
import sys
from pathlib import Path

import pytest
from rich.console import Console

import study.pipeline.cluster
from study.paper.finished_runs import RUNS, run_table
from study.paper.presets import SMOKE
from study.paper.reference_controllers import REFERENCES
from study.paper.sweep import Sweep, sweep_results
from study.pipeline.cluster import Cluster
from study.pipeline.executor import Processes, WorkerFailed
from study.pipeline.settings import versions
from study.pipeline.stages import run as run_study
from study.pipeline.tables import write_rows
from sysid import InvalidInput
from tests.study.counting import Counting, done, run, saved_at_an_interrupt

NODE = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
SAVES_WHEN_ASKED = {"end": 100_000, "every": 100_000, "pause": 0.001}
PRESET = dataclasses.replace(SMOKE, steps=3000, grid=40)


class Machines:
    """A head with the driver, and a second node, of one core each; both are processes of this machine."""

    def __init__(self):
        pytest.importorskip("ray", reason="`make test` leaves Ray out: pip install -e '.[cluster]'")
        from ray.cluster_utils import Cluster as Nodes

        self.nodes = Nodes(initialize_head=True, head_node_args=NODE)
        self.second = self.nodes.add_node(**NODE)
        self.executor = Cluster(self.nodes.address)

    def kill_worker(self, task):
        """Kill the process that runs a task; Ray gives it the task's name."""
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                title = (process / "cmdline").read_bytes().rstrip(b"\0").decode()
                if title == f"ray::{task.name}" and self.owns(int(process.name)):
                    os.kill(int(process.name), signal.SIGKILL)
                    return
        raise AssertionError(f"nothing runs {task.name}")

    def owns(self, pid):
        while pid > 1 and pid != os.getpid():
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        return pid == os.getpid()

    def remove_second(self):
        self.nodes.remove_node(self.second, allow_graceful=False)


@pytest.fixture(scope="module")
def machines():
    machines = Machines()
    yield machines
    machines.nodes.shutdown()


def test_without_ray_a_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InvalidInput, match=r"needs Ray: pip install 'gapfinder\[cluster\]'"):
        Cluster("auto")


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:10001", "nonsense"])
def test_an_address_where_no_cluster_answers_is_refused(address):
    pytest.importorskip("ray")
    with pytest.raises(InvalidInput, match=address):
        Cluster(address).execute([], lambda *said: None)


def test_a_worker_that_dies_goes_on_from_its_checkpoint_by_itself(machines, tmp_path):
    said = run(machines.executor, Counting("mortal", tmp_path, deaths=(0, 2, 2, 3)), Counting("other", tmp_path))
    why = [payload for _, kind, payload in said if kind == "died"]
    assert why == ["The worker died unexpectedly while executing this task"] * 4
    assert done(said) == {"mortal": [0, 0, 2, 2, 3], "other": [0]}


def test_a_task_that_gets_nowhere_ends_the_study_after_the_others_saved(machines, tmp_path):
    slow = Counting("slow", tmp_path, **SAVES_WHEN_ASKED)
    with pytest.raises(WorkerFailed, match=r"mortal failed: its worker died 3 times without a new checkpoint; .*"):
        run(machines.executor, slow, Counting("mortal", tmp_path, deaths=(1,) * 9))
    assert 0 < int(slow.checkpoint.read_text()) < slow.end


def test_an_interrupted_driver_hears_what_its_workers_saved(machines, tmp_path):
    tasks = [Counting(f"task {k}", tmp_path, **SAVES_WHEN_ASKED) for k in range(2)]
    assert saved_at_an_interrupt(machines.executor, tasks) == {task.name for task in tasks}
    assert all(0 < int(task.checkpoint.read_text()) < task.end for task in tasks)


def test_a_task_that_raises_or_that_no_node_can_run_is_named(machines, tmp_path, monkeypatch):
    with pytest.raises(WorkerFailed, match=r"^wrong failed: ValueError: cannot count on \(counting.py, line \d+\)$"):
        run(machines.executor, Counting("wrong", tmp_path, raises_at=2))
    with pytest.raises(InvalidInput, match=r"needs 1 GPU, the cluster at .* has 0"):
        run(machines.executor, Counting("graphical", tmp_path, gpus=1))
    monkeypatch.setattr(study.pipeline.cluster, "versions", lambda: versions() | {"numpy": "0.1"})
    with pytest.raises(WorkerFailed, match=r"^elsewhere failed: the node .* has numpy \d.*, not 0.1, which may give"):
        run(machines.executor, Counting("elsewhere", tmp_path))


@dataclasses.dataclass
class Struck:
    """An executor that loses a worker at the first checkpoint, and the second node at the first one after that."""

    machines: Machines
    deaths: int = 0
    struck: int = 0
    workers = None

    def execute(self, tasks, heard):
        def strike(task, kind, payload):
            heard(task, kind, payload)
            self.deaths += kind == "died"
            if kind == "saved" and self.struck == 0:
                self.machines.kill_worker(task)
                self.struck = 1
            elif kind == "saved" and self.struck == self.deaths == 1:
                self.machines.remove_second()
                self.struck = 2

        self.machines.executor.execute(tasks, strike)


def runs(folder, executor):
    """The lines of runs.csv but for the times."""
    folder.mkdir()
    with sweep_results(folder, PRESET) as store:
        run_study(Sweep(PRESET, store, 0.1), executor, Console(file=io.StringIO()))
        kept = store.all(RUNS), store.all(REFERENCES)
        write_rows(folder / "runs.csv", *run_table(kept[0]))
    lines = [line.split(",") for line in (folder / "runs.csv").read_text().splitlines()]
    time = lines[0].index("wall_time_s")
    return [line[:time] + line[time + 1 :] for line in lines]


def test_a_study_that_loses_a_worker_and_a_node_gives_the_numbers_of_processes(machines, tmp_path):
    struck = Struck(machines)
    assert runs(tmp_path / "cluster", struck) == runs(tmp_path / "processes", Processes(2))
    assert struck.struck == 2
    assert struck.deaths >= 2
