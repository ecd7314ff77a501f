"""Nothing that was computed is lost, and nothing is computed twice, whoever dies."""

import signal
from pathlib import Path

import pytest
from processes import alive, family, kill_all, wait_for

from services.store.open import open_store

STUDY = """
name: killed
task: point_jump
search: {{strategy: bds, settings: {{variant: published}}, trials: 4}}
training: {{budget: {{samples: {samples}}}}}
resources: {{parallel: {parallel}}}
seed: 11
"""

pytestmark = [pytest.mark.ray, pytest.mark.slow]


def what_counts(trial):
    """All of a trial that does not depend on the time of day."""
    return {
        **{key: trial[key] for key in ("number", "state", "params", "z", "value", "features", "seed")},
        "samples": trial["cost"]["samples"],
        "policy": trial["artifacts"]["policy.safetensors"]["sha256"],
    }


def curve(store, row, number):
    return [metric.iteration for metric in store.metrics(store.trial(row.id, number).id)]


def under_way(home, file, *, after):
    """Start the study and wait until trial `after` has made some iterations."""
    process = home.start("run", file)
    store = wait_for(lambda: open_store(home.folder / "halma.db") if (home.folder / "halma.db").exists() else None)

    def far_enough():
        if process.poll() is not None:
            raise AssertionError(process.stdout.read())
        rows = {row.name: row for row in store.studies()}
        if "killed" not in rows:
            return None
        trials = store.trials(rows["killed"].id)
        return rows["killed"] if len(trials) > after and trials[after].iteration >= 3 else None

    return process, store, wait_for(far_enough)


def killed_in_the_middle(home, file, *, after):
    """Start the study, wait until trial `after` has made some iterations, and kill everybody."""
    process, store, row = under_way(home, file, after=after)
    kill_all(family(process.pid))
    process.communicate()
    return store, row


def title(pid):
    return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")


def test_a_killed_study_goes_on_where_it_was(home):
    file = home.write("study.yaml", STUDY.format(samples=40_000, parallel=2))
    store, row = killed_in_the_middle(home, file, after=1)
    before = {trial["number"]: trial for trial in home.trials("killed")}
    curves = {number: curve(store, row, number) for number in before}
    home.run("resume", "killed")
    after = {trial["number"]: trial for trial in home.trials("killed")}
    assert sorted(after) == [0, 1, 2, 3]
    assert {trial["state"] for trial in after.values()} <= {"complete", "infeasible"}
    for number, trial in before.items():
        if trial["state"] in {"complete", "infeasible"}:
            assert after[number] == trial
        else:
            assert after[number]["params"] == trial["params"]
            # It went on from its checkpoint: no iteration is missing, none was counted anew from the start.
            assert curve(store, row, number) == list(range(1, len(curve(store, row, number)) + 1))
            last_attempt = store.attempts(store.trial(row.id, number).id)[-1]
            assert last_attempt.first_iteration >= len(curves[number]), (last_attempt, curves[number])
    store.close()


def test_a_killed_and_resumed_study_equals_an_undisturbed_one_bit_for_bit(home, tmp_path_factory):
    undisturbed = type(home)(tmp_path_factory.mktemp("undisturbed"))
    text = STUDY.format(samples=15_000, parallel=1)
    undisturbed.run("run", undisturbed.write("study.yaml", text), "--inline")
    store, _ = killed_in_the_middle(home, home.write("study.yaml", text), after=2)
    store.close()
    home.run("resume", "killed")
    expected = [what_counts(trial) for trial in undisturbed.trials("killed")]
    assert [what_counts(trial) for trial in home.trials("killed")] == expected
    assert len(expected) == 4


@pytest.mark.parametrize("victim", ["Worker", "StrategyActor", "CoordinatorActor"])
def test_a_study_outlives_each_of_its_processes(home, victim):
    file = home.write("study.yaml", STUDY.format(samples=40_000, parallel=2))
    process, store, row = under_way(home, file, after=1)
    victims = [pid for pid in family(process.pid) if f"ray::{victim}" in title(pid)]
    assert victims
    kill_all(victims[:1])
    output, _ = process.communicate(timeout=600)
    assert process.returncode == 0, output
    trials = store.trials(row.id)
    assert [trial.number for trial in trials] == [0, 1, 2, 3]
    assert sorted(trial.position for trial in trials) == [0, 1, 2, 3]
    for trial in trials:
        assert trial.state.value in {"complete", "infeasible"}
        states = [attempt.state.value for attempt in store.attempts(trial.id)]
        assert states[-1] == trial.state.value
        assert set(states[:-1]) <= {"lost"}
        iterations = curve(store, row, trial.number)
        assert iterations == list(range(1, len(iterations) + 1))
    if victim == "Worker":
        assert sum(trial.retries for trial in trials) == 1
    store.close()


def test_without_rays_own_processes_the_command_ends_and_says_how_to_go_on(home):
    file = home.write("study.yaml", STUDY.format(samples=6_000, parallel=2))
    process, store, row = under_way(home, file, after=1)
    everybody = family(process.pid)
    (gcs,) = [pid for pid in everybody if "gcs_server" in title(pid).split("\0")[0]]
    kill_all([gcs])
    output, _ = process.communicate(timeout=100)
    assert process.returncode == 1, output
    assert (
        f"Ray's gcs_server (process {gcs}) has ended, and with it this run; what had finished is on record." in output
    )
    assert output.rstrip().endswith("Go on with: halma resume killed")
    wait_for(lambda: not alive(everybody))
    before = {trial.number: trial for trial in store.history(row.id)}
    home.run("resume", "killed", "--inline")
    after = {trial.number: trial for trial in store.history(row.id)}
    assert sorted(after) == [0, 1, 2, 3]
    assert {number: after[number] for number in before} == before
    store.close()


def test_ctrl_c_stops_at_a_checkpoint_and_leaves_no_process_behind(home):
    file = home.write("study.yaml", STUDY.format(samples=2_000_000, parallel=2))
    process = home.start("run", file)
    store = wait_for(lambda: open_store(home.folder / "halma.db") if (home.folder / "halma.db").exists() else None)
    row = wait_for(lambda: next(iter(store.studies()), None))
    wait_for(lambda: [t for t in store.trials(row.id) if t.iteration >= 2])
    everybody = family(process.pid)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 130, output
    assert "halma resume killed" in output
    row = store.study("killed")
    assert (row.state.value, row.reason, row.driver) == ("paused", "interrupted", None)
    for trial in store.trials(row.id):
        assert trial.state.value == "queued"
        assert store.attempts(trial.id)[-1].state.value == "preempted"
    wait_for(lambda: not alive(everybody))
    store.close()
