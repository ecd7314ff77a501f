import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.workers.toy_environments import Target, job
from workers.contracts import Interrupted, Outcome
from workers.local_context import LocalContext
from workers.run import run

QUICK = {"budget": {"iterations": 2}, "network": {"hidden": [8]}, "ppo": {"samples": 60, "environments": 2}}


class Nan(Target):
    def step(self, action):
        observation, _, over, cut, info = super().step(action)
        return observation, float("nan"), over, cut, info


class Raising(Target):
    def step(self, action):
        raise OSError("the simulator is gone")


def slope(params):
    return 2 * params["x"]


def here(name):
    return f"tests.workers.test_run:{name}"


def test_a_job_that_goes_well_is_complete(tmp_path):
    found = run(job(task=here("slope"), params={"x": 3.0}), LocalContext(tmp_path))
    assert (found.status, found.value) == ("complete", 6.0)


def test_a_divergence_is_an_outcome_with_iteration_and_quantity(tmp_path):
    found = run(job(task=here("Nan"), training=QUICK), LocalContext(tmp_path))
    assert (found.status, found.message) == ("diverged", "iteration 1: reward became NaN")
    assert found.details == {"iteration": 1, "quantity": "reward"}
    assert found.cost.samples == 1, "what was played has been paid for"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"task": "no_such"}, "task 'no_such': unknown"),
        ({"task": here("slope"), "params": {}}, "space.: expected at least one parameter"),
        ({"task": here("Target"), "training": {"budget": {"samples": 0}}}, "training.budget.samples: expected a whole"),
        (
            {"task": here("Target"), "training": QUICK, "parent": 4},
            "warm start from trial 4: parent: expected its policy.safetensors",
        ),
    ],
)
def test_a_job_that_cannot_be_run_as_it_stands_has_failed_for_good(tmp_path, fields, message):
    found = run(job(**fields), LocalContext(tmp_path))
    assert found.status == "failed"
    assert found.message.startswith(message)
    assert found.details == {"retry": False}
    assert found.message in (tmp_path / "log.txt").read_text()


def test_an_interruption_is_no_outcome(tmp_path):
    with pytest.raises(Interrupted):
        run(job(training=QUICK), LocalContext(tmp_path, stop=lambda: True))


def test_any_other_exception_is_left_to_the_service(tmp_path):
    with pytest.raises(OSError, match="the simulator is gone"):
        run(job(task=here("Raising"), training=QUICK), LocalContext(tmp_path))


def test_an_outcome_survives_the_wire(tmp_path):
    found = run(job(training=QUICK, params={"speed": 2.0}), LocalContext(tmp_path))
    assert Outcome.from_json(found.to_json()) == found


def test_a_function_runs_without_waiting_for_torch(tmp_path):
    (tmp_path / "light.py").write_text("def slope(params):\n    return 2 * params['x']\n")
    program = """
import sys
from pathlib import Path
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.run import run

outcome = run(Job("s", 0, "light:slope", {"x": 1.5}, 1), LocalContext(Path("trial")))
print(outcome.value, sorted({"torch", "gymnasium", "pybullet"} & set(sys.modules)))
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "3.0 []\n"
