"""The pages of one study in a real browser, over a real server and a real record."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from services.states import TrialState
from tests.dashboards.conftest import until
from tests.record import Record

pytestmark = pytest.mark.browser


@pytest.fixture
def record(service):
    return Record(service.store, service.artifacts, "jump").begin()


def ready(watched, path):
    """Open a page and wait until its script has drawn it and listens."""
    page = watched.open(path)
    page.wait_for_selector("#link[data-state=live]")
    return page


class TestStudy:
    def test_counts_rows_and_charts_rise_without_reloading(self, browser, record):
        record.one(value=0.5, features=(0.0,))
        page = ready(browser, "/studies/jump")
        page.evaluate("window.notReloaded = true")
        rows = page.locator("#table tbody tr[data-number]")
        expect(page.locator("#fact-trials")).to_have_text("1 of 24 done")
        expect(rows).to_have_count(1)
        record.one(value=0.75, features=(1.5,))
        (trial,) = record.propose()
        record.start(trial)
        expect(page.locator("#fact-trials")).to_have_text("2 of 24 done")
        expect(page.locator("#fact-running")).to_have_text("1 running")
        expect(page.locator("#fact-best")).to_have_text("0.75")
        expect(rows).to_have_count(3)
        expect(page.locator("#table tr[data-number='2']")).to_contain_text("running")
        expect(page.locator("#fact-distinct")).to_have_text("2")
        expect(page.locator("#gallery .strategy")).to_have_count(2)
        expect(page.locator("#behaviour a[data-number]")).to_have_count(2)
        expect(page.locator("#value-chart .points path")).to_have_count(2)
        assert page.evaluate("window.notReloaded")
        browser.assert_calm()

    def test_what_the_value_is_called_is_learnt_from_the_first_trial(self, browser, record):
        page = ready(browser, "/studies/jump")
        (trial,) = record.propose()
        attempt = record.start(trial)
        expect(page.locator("#table thead")).to_contain_text("Value")
        expect(page.locator("#progress i")).to_have_count(1)
        record.finish(attempt, trial, value=0.8125, features=(0.5,), bar=0.8125)
        expect(page.locator("#value-chart .ytitle")).to_have_text("bar (m)")
        expect(page.locator("#table thead")).to_contain_text("Bar (m)")
        expect(page.locator("#gallery .figure")).to_have_text("bar 0.8125 m")
        expect(page.locator("#fact-best")).to_have_text("0.8125 m")
        record.start(record.propose()[0])
        expect(page.locator("#progress i")).to_have_count(2)
        states = "all => all.map((one) => one.dataset.state)"
        assert page.locator("#progress i").evaluate_all(states) == ["complete", "running"]

    def test_what_is_finished_is_told_by_stage(self, browser, service):
        stages = {
            "polish": {"kind": "polish", "after": ["search", "novelty"]},
            "novelty": {"kind": "novelty", "after": ["search"], "strategies": 1, "trainings": 2},
        }
        made = Record(service.store, service.artifacts, "staged", target=3, stages=stages).begin()
        made.one(value=0.5, features=(0.0,))
        page = ready(browser, "/studies/staged")
        expect(page.locator("#fact-stages")).to_have_text("search 1, novelty 0, polish 0")
        (trial,) = made.propose(stage="novelty")
        made.start(trial)
        expect(page.locator("#fact-stages")).to_have_text("search 1, novelty 0 (1 running), polish 0")
        # Three of the search, twice one of the novelty, and five times five of the polish are the most there can be.
        expect(page.locator("#fact-trials")).to_have_text("1 of 30 done")
        expect(page.locator("#fact-running")).to_have_text("1 running")
        browser.assert_calm()

    def test_states_are_shown_as_they_are(self, browser, record):
        record.one(state=TrialState.DIVERGED, message="the return became NaN at iteration 3")
        record.one(state=TrialState.INFEASIBLE)
        page = ready(browser, "/studies/jump")
        expect(page.locator("#table tr[data-number='0']")).to_contain_text("≈ diverged")
        expect(page.locator("#table tr[data-number='1']")).to_contain_text("◇ infeasible")
        expect(page.locator("#fact-best")).to_have_text("–")
        browser.assert_calm()

    def test_hovering_a_strategy_lights_it_everywhere(self, browser, record):
        record.one(features=(0.0,))
        record.one(features=(2.0,))
        page = ready(browser, "/studies/jump")
        page.hover(".strategy[data-number='1']")
        expect(page.locator("#table tr[data-number='1']")).to_have_class("lit")
        expect(page.locator("#behaviour .lit-mark")).to_have_count(1)

    def test_a_study_without_behaviour_shows_none(self, browser, service):
        Record(service.store, service.artifacts, "quality", behaviour=None).begin().one()
        page = ready(browser, "/studies/quality")
        expect(page.locator("#behaviour-panel")).to_have_count(0)
        expect(page.locator("#value-chart .points path")).to_have_count(1)
        browser.assert_calm()

    def test_an_empty_study_says_what_will_appear(self, browser, record):
        page = ready(browser, "/studies/jump")
        expect(page.locator("#value-chart")).to_contain_text("The first finished trial appears here.")
        expect(page.locator("#table")).to_contain_text("No trials yet")
        browser.assert_calm()

    def test_the_chart_follows_samples_and_time(self, browser, record):
        record.one()
        record.one()
        page = ready(browser, "/studies/jump")
        for button, title in (("by samples", "samples spent (control steps)"), ("by time", "(min)")):
            page.click(f"text={button}")
            expect(page.locator("#value-chart .xtitle")).to_contain_text(title)

    def test_an_unknown_study_is_told_in_words(self, browser, record):
        page = browser.open("/studies/jmp")
        expect(page.locator("main")).to_contain_text("found 'jump'")
        browser.assert_calm(but=["404"])

    def test_a_deleted_study_is_told_in_an_open_tab(self, browser, service, record):
        record.one()
        page = ready(browser, "/studies/jump")
        record.end()
        with service.store.transaction() as change:
            change.delete_study("jump")
        expect(page.locator("#banner")).to_contain_text("The study jump was deleted.")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(1)


class TestTrials:
    def test_a_condition_filters_and_is_kept_in_the_address(self, browser, record):
        for value in (0.2, 0.6, 0.9):
            record.one(value=value)
        record.one(state=TrialState.FAILED)
        page = ready(browser, "/studies/jump/trials")
        rows = page.locator("#table tbody tr[data-number]")
        expect(rows).to_have_count(4)
        page.fill("#filters input[type=search]", "value > 0.5")
        expect(rows).to_have_count(2)
        expect(page.locator("#filters [role=status]")).to_have_text("2 of 4 trials")
        ready(browser, page.url.removeprefix(browser.url))
        expect(rows).to_have_count(2)
        page.fill("#filters input[type=search]", "height > 0.5")
        expect(page.locator("#filters [role=status]")).to_contain_text(
            "Unknown column height. Known: number, state, value"
        )

    @pytest.mark.parametrize(
        ("condition", "numbers"),
        [
            ("facing > 90°", ["1"]),
            ("facing < 90 and value > 0.3", ["2"]),
            ("omega_x = 0", ["0"]),
            ("1", ["1"]),
            ("nan", ["3"]),
            ("params.alpha > 2", []),
        ],
    )
    def test_filters_read_what_the_table_shows(self, browser, record, condition, numbers):
        for value, facing in ((0.2, 0.1), (0.4, 2.0), (0.6, -1.0)):
            record.one(value=value, features=(facing,), iterations=1)
        record.one(state=TrialState.DIVERGED, message="the return became NaN", iterations=1)
        page = ready(browser, "/studies/jump/trials")
        page.fill("#filters input[type=search]", condition)
        expect(page.locator("#filters [role=status]")).to_have_text(f"{len(numbers)} of 4 trials")
        rows = page.locator("#table tbody tr[data-number]")
        expect(rows).to_have_count(len(numbers))
        assert rows.evaluate_all("all => all.map((one) => one.dataset.number)") == numbers
        browser.assert_calm()

    def test_states_and_columns_can_be_hidden(self, browser, record):
        record.one()
        record.one(state=TrialState.FAILED)
        page = ready(browser, "/studies/jump/trials")
        page.click("#filters button[data-state=failed]")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(1)
        page.click("summary")
        page.uncheck("text=alpha (rad)")
        expect(page.locator("#table thead")).not_to_contain_text("alpha")

    def test_the_download_holds_the_trials(self, browser, record):
        record.one(value=0.5)
        page = ready(browser, "/studies/jump/trials")
        with page.expect_download() as download:
            page.click("text=Download CSV")
        assert download.value.suggested_filename == "jump.csv"
        head, row = (line.split(",") for line in download.value.path().read_text().splitlines())
        assert head[:5] == ["number", "state", "value", "facing", "z"]
        assert row[:3] == ["0", "complete", "0.5"]


class TestTrial:
    def test_it_shows_parameters_outcome_curve_attempts_and_files(self, browser, record):
        record.one(value=0.75, iterations=8)
        page = ready(browser, "/studies/jump/trials/0")
        main = page.locator("main")
        for text in ("omega_x", "rad/s", "0.75", "audit.push", "default-0", "policy.safetensors", str(2**63)):
            expect(main).to_contain_text(text)
        for metric in ("return", "bar", "success", "kl"):
            expect(page.locator(f"#curves [data-metric={metric}] .scatterlayer .js-line")).to_have_count(1)
        assert page.evaluate("document.querySelector('img.pose').naturalWidth") == 320
        browser.assert_calm()

    def test_its_curve_grows_and_its_outcome_appears_without_reloading(self, browser, record):
        (trial,) = record.propose()
        page = ready(browser, "/studies/jump/trials/0")
        page.evaluate("window.notReloaded = true")
        expect(page.locator("#curves")).to_contain_text("The curves begin with the first finished iteration.")
        expect(page.locator("[data-live=attempts]")).to_contain_text("Waiting for a free worker.")
        attempt = record.start(trial)
        expect(page.locator("[data-live=attempts]")).to_contain_text("running")
        for iteration in (1, 2, 3):
            record.report(attempt, iteration, **{"return": 0.1 * iteration})
        until(
            lambda: (
                page.evaluate("document.querySelector('#curves [data-metric=return] .small-chart')?.data?.[0].x.length")
                == 3
            )
        )
        record.finish(attempt, trial, value=0.5, features=(0.25,), bar=0.61)
        expect(page.locator("[data-live=head]")).to_contain_text("complete")
        expect(page.locator("[data-live=details]")).to_contain_text("0.61")
        assert page.evaluate("window.notReloaded")
        browser.assert_calm()

    def test_metrics_can_be_chosen_and_are_remembered(self, browser, record):
        record.one()
        page = ready(browser, "/studies/jump/trials/0")
        expect(page.locator("#curves [data-metric=kl] .js-line")).to_have_count(1)
        page.click("#metric-choice [data-metric=kl]")
        expect(page.locator("#curves [data-metric=kl]")).to_have_count(0)
        ready(browser, "/studies/jump/trials/0")
        expect(page.locator("#curves [data-metric=samples_per_second] .js-line")).to_have_count(1)
        expect(page.locator("#curves [data-metric=kl]")).to_have_count(0)
        page.click("#metric-choice [data-metric=kl]")
        expect(page.locator("#curves [data-metric=kl] .js-line")).to_have_count(1)

    def test_one_without_motion_says_why(self, browser, record):
        record.one(state=TrialState.DIVERGED, message="the return became NaN at iteration 3")
        page = ready(browser, "/studies/jump/trials/0")
        expect(page.locator("[data-live=motion]")).to_contain_text("left no motion: the return became NaN")
        browser.assert_calm()


class TestSearchAndQuality:
    def test_any_two_are_shown_with_what_runs_and_what_failed(self, browser, record):
        for _ in range(3):
            record.one()
        record.one(state=TrialState.DIVERGED)
        record.start(record.propose(2, mode="diversify")[0])
        page = ready(browser, "/studies/jump/search")
        expect(page.locator("#map .legendtext")).to_have_text(
            ["finished", "diverged", "running", "queued", "next proposal"]
        )
        expect(page.locator("#why .legendtext")).to_have_text(["explore", "diversify"])
        page.select_option("#map-x", "alpha")
        page.select_option("#map-y", "omega_x")
        expect(page.locator("#map .xtitle")).to_have_text("alpha (rad)")
        ready(browser, page.url.removeprefix(browser.url))
        expect(page.locator("#map .ytitle")).to_have_text("omega_x (rad/s)")
        browser.assert_calm()

    def test_a_range_on_an_axis_picks_the_lines_through_it(self, browser, record):
        for value in (0.1, 0.5, 0.9):
            record.one(value=value)
        page = ready(browser, "/studies/jump/quality")
        expect(page.locator("#lines polyline")).to_have_count(3)
        expect(page.locator("#each [data-parameter]")).to_have_count(2)
        box = page.locator("[data-axis=value]").bounding_box()
        x = box["x"] + box["width"] / 2
        page.mouse.move(x, box["y"] + 1)
        page.mouse.down()
        page.mouse.move(x, box["y"] + 30, steps=3)
        page.mouse.up()
        chosen = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--accent').trim()")
        expect(page.locator(f"#lines polyline[stroke='{chosen}']")).to_have_count(1)


class TestPictures:
    def test_a_chart_can_be_saved(self, browser, record):
        record.one()
        page = ready(browser, "/studies/jump")
        expect(page.locator("#value-chart .points path")).to_have_count(1)
        with page.expect_download() as download:
            page.click("[aria-labelledby=h-value] [data-save=svg]")
        assert download.value.suggested_filename == "jump-value.svg"
        assert b"<svg" in download.value.path().read_bytes()[:200]
        browser.assert_calm()

    @pytest.mark.parametrize(
        ("path", "box", "name"),
        [
            ("/studies/jump/trials/0", "#curves [data-metric=kl]", "jump-0-kl"),
            ("/studies/jump/quality", "#each [data-parameter=alpha]", "jump-alpha"),
        ],
    )
    def test_a_small_one_can_be_saved_too(self, browser, record, path, box, name):
        record.one()
        page = ready(browser, path)
        page.locator(f"{box} .main-svg").first.wait_for()
        page.locator(box).scroll_into_view_if_needed()
        page.hover(box)
        with page.expect_download() as download:
            page.click(f"{box} [data-save=png]")
        assert download.value.suggested_filename == f"{name}.png"
        assert download.value.path().read_bytes()[:4] == b"\x89PNG"
        browser.assert_calm()


class TestDifficulty:
    def test_a_value_of_an_easier_version_is_not_the_best_of_the_task(self, browser, record):
        record.one(value=0.9, z=0.2)
        record.one(value=0.4)
        record.one(value=0.5)
        page = ready(browser, "/studies/jump")
        expect(page.locator("#fact-best")).to_have_text("0.5")
        expect(page.locator("#value-chart .points path")).to_have_count(3)
        line = "document.querySelector('#value-chart').data.find((trace) => trace.name === 'best so far').y"
        until(lambda: page.evaluate(line) == [0.4, 0.5, 0.5])

    def test_lines_and_marks_of_easier_versions_stay_behind_the_best_of_the_task(self, browser, record):
        record.one(value=0.9, z=0.2)
        record.one(value=0.5)
        record.one(value=0.4)
        page = ready(browser, "/studies/jump/quality")
        expect(page.locator("#lines polyline title")).to_have_text(
            ["trial 0, value 0.9", "trial 2, value 0.4", "trial 1, value 0.5"]
        )
        expect(page.locator("#lines [data-axis=difficulty]")).to_have_count(1)
        marks = "document.querySelector('#each [data-parameter=alpha] .js-plotly-plot').data[0].marker.opacity"
        until(lambda: page.evaluate(marks) == [0.3, 0.75, 0.75])
        browser.assert_calm()
