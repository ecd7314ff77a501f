"""The service as people use it: serve in one terminal, submit and watch in another, the page in a browser."""

import json
import re
import signal

import pytest
from processes import alive, family, wait_for

STUDY = """
name: served
task: point_jump
search: {strategy: sobol, trials: 6}
training: {budget: {samples: 6000}}
resources: {parallel: 2}
seed: 3
"""


def follow(process):
    """Lines of a process until it says its address and token."""
    said = {}
    while "token" not in said:
        line = process.stdout.readline()
        assert line, f"the service ended: {process.poll()}"
        if found := re.search(r"halma is at (\S+)", line):
            said["url"] = found[1]
        if found := re.search(r"Access token .*: (\S+)$", line):
            said["token"] = found[1]
    return said


@pytest.mark.ray
@pytest.mark.slow
@pytest.mark.browser
def test_a_submitted_study_is_driven_watched_and_seen_rising_in_the_browser(home, chromium):
    server = home.start("serve", "--port", "0")
    everybody = [server.pid]
    try:
        said = follow(server)
        context = chromium.new_context()
        page = context.new_page()
        hosts = set()
        page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
        page.goto(said["url"])
        page.get_by_label("token").fill(said["token"])
        page.keyboard.press("Enter")
        page.wait_for_url(re.compile(r"/(studies)?$"))
        home.run("submit", home.write("study.yaml", STUDY))
        page.goto(f"{said['url']}/studies/served")
        counts = []

        def rises():
            counts.append(page.locator("[data-trial-number], table tbody tr").count())
            return counts[-1] >= 6

        loads = []
        page.on("load", lambda event: loads.append(event))  # noqa: PLW0108 - playwright takes no bound builtin
        watched = home.run("watch", "served")
        wait_for(rises)
        assert loads == []  # nothing was loaded anew
        assert counts == sorted(counts)
        assert "complete" in watched
        assert hosts == {said["url"].split("/")[2]}
        everybody = family(server.pid)
    finally:
        server.send_signal(signal.SIGTERM)
        output, _ = server.communicate(timeout=300)
    assert server.returncode == 0, output
    assert len(home.trials("served")) == 6
    wait_for(lambda: not alive(everybody))


@pytest.mark.postgres
def test_the_same_study_on_postgresql_gives_the_same_trials(home, postgres_server):
    file = home.write("study.yaml", STUDY)
    url = postgres_server.new_database("served")
    home.run("run", file, "--inline")
    home.run("run", file, "--inline", "--db", url)

    def what_counts(*where):
        trials = json.loads(home.run("trials", "served", "--json", *where))
        keys = ("number", "state", "params", "value", "features", "seed")
        return [{**{key: trial[key] for key in keys}, "left": trial["artifacts"]} for trial in trials]

    def policies(trials):
        return [trial.pop("left")["policy.safetensors"]["sha256"] for trial in trials]

    here, there = what_counts(), what_counts("--db", url)
    assert policies(here) == policies(there)
    assert here == there
    assert len(here) == 6


def test_two_runs_on_one_home_do_not_drive_the_same_study_twice(home):
    file = home.write("study.yaml", STUDY.replace("6000", "400000"))
    first = home.start("run", file, "--inline")
    try:
        wait_for(lambda: "running" in home.run("ls"), every=1.0)
        told = home.run("run", file, "--inline", expect=2)
        assert "found process" in told
        assert str(first.pid) in told
    finally:
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=300)
    assert first.returncode == 130
