"""The pages in a real browser, over a real server and a real record."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from services.auth import COOKIE
from services.states import TrialState
from tests.dashboards.conftest import TOKEN, log_in, until
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


class TestLogin:
    def test_every_page_leads_to_the_login_page_and_from_there_back(self, anyone, record):
        page = anyone.open("/studies/jump/trials?where=value+%3E+0.5")
        assert page.url.startswith(f"{anyone.url}/login?next=")
        page.fill("#token", TOKEN)
        page.click("button[type=submit]")
        page.wait_for_url(f"{anyone.url}/studies/jump/trials?where=value+%3E+0.5")
        anyone.assert_calm()

    def test_the_cookie_is_no_token_and_no_script_can_read_it(self, anyone):
        log_in(anyone)
        (cookie,) = anyone.page.context.cookies()
        assert cookie["name"] == COOKIE
        assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Strict")
        assert TOKEN not in cookie["value"]
        assert anyone.page.evaluate("document.cookie") == ""

    def test_a_wrong_token_is_told_and_guessing_is_slowed_down(self, anyone):
        page = anyone.open("/login")
        for _ in range(5):
            page.fill("#token", "a-wrong-token")
            page.click("button[type=submit]")
            expect(page.locator("#problem")).to_have_text("That is not the token of this service.")
        page.fill("#token", TOKEN)
        page.click("button[type=submit]")
        expect(page.locator("#problem")).to_contain_text("Too many wrong tokens from 127.0.0.1. Try again in")

    def test_logging_out_ends_it(self, browser):
        browser.open("/")
        browser.page.click("text=Log out")
        browser.page.wait_for_url(f"{browser.url}/login")
        assert browser.open("/").url.startswith(f"{browser.url}/login")

    def test_a_login_leads_nowhere_else(self, anyone):
        page = anyone.open("/login?next=https://evil.example/")
        page.fill("#token", TOKEN)
        page.click("button[type=submit]")
        page.wait_for_url(f"{anyone.url}/")


class TestStudies:
    def test_the_list_grows_and_moves_without_reloading(self, browser, service, record):
        page = ready(browser, "/")
        page.evaluate("window.notReloaded = true")
        row = page.locator("tr[data-study=jump]")
        expect(row).to_contain_text("0 of 24 done")
        record.one(value=0.8125)
        expect(row).to_contain_text("1 of 24 done")
        expect(row).to_contain_text("0.8125")
        Record(service.store, service.artifacts, "second").begin()
        expect(page.locator("tr[data-study=second]")).to_contain_text("running")
        assert page.evaluate("window.notReloaded")
        browser.assert_calm()

    def test_without_studies_it_says_what_to_type(self, browser):
        page = ready(browser, "/")
        expect(page.locator("#nothing")).to_contain_text("halma submit studies/high_jump.yaml")

    def test_a_search_is_kept_in_the_address(self, browser, service, record):
        Record(service.store, service.artifacts, "straddle").begin()
        page = ready(browser, "/")
        page.fill("#find", "stra")
        expect(page.locator("#studies tbody tr")).to_have_count(1)
        ready(browser, page.url.removeprefix(browser.url))
        expect(page.locator("#studies tbody tr")).to_have_count(1)
        page.fill("#find", "nothing like it")
        expect(page.locator("#nothing")).to_have_text("No study matches. Clear the search to see all of them.")

    def test_it_is_sorted_by_a_click_on_a_head(self, browser, service, record):
        record.one(value=0.5)
        Record(service.store, service.artifacts, "better").begin().one(value=0.9)
        page = ready(browser, "/")
        page.click("th[data-sort=best]")
        names = page.locator("#studies tbody td:first-child a")
        expect(names).to_have_text(["better", "jump"])
        page.click("th[data-sort=best]")
        expect(names).to_have_text(["jump", "better"])


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
        expect(page.locator("#fact-trials")).to_have_text("2 of 24 done, 1 running")
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
        expect(page.locator("#fact-trials")).to_have_text("1 of 30 done, 1 running")
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


class TestEvents:
    def test_they_are_told_in_words_newest_first_and_go_on(self, browser, record):
        record.one(iterations=2)
        page = ready(browser, "/studies/jump/events")
        items = page.locator("#events li")
        expect(items.first).to_contain_text("complete, value")
        expect(items.last).to_contain_text("study created, for 24 trials")
        count = items.count()
        record.propose()
        expect(items.first).to_contain_text("bds proposed trial 1")
        page.check("text=every iteration")
        expect(items).to_have_count(count + 3)
        browser.assert_calm()

    def test_what_is_looked_for_is_kept_in_the_address(self, browser, record):
        record.one(iterations=1)
        record.one(iterations=1, state=TrialState.DIVERGED, message="the return became NaN")
        page = ready(browser, "/studies/jump/events")
        page.fill("#filters input[type=search]", "trial 1")
        items = page.locator("#events li")
        expect(items.last).to_contain_text("bds proposed trial 1")
        expect(items.first).to_contain_text("diverged: the return became NaN")
        ready(browser, page.url.removeprefix(browser.url))
        expect(items.first).to_contain_text("diverged")
        expect(items).to_have_count(3)
        page.fill("#filters input[type=search]", "nothing like it")
        expect(page.locator("#events")).to_have_text("No event matches.")

    def test_those_of_long_ago_stay_on_the_server_until_they_are_asked_for(self, browser, service, record):
        record.one(iterations=1)
        # Ids count up over all studies: here as if others had caused 50,000 events meanwhile.
        with service.store._engine.begin() as connection:
            connection.exec_driver_sql("UPDATE sqlite_sequence SET seq = seq + 50000 WHERE name = 'events'")
        for _ in range(40):
            record.one(iterations=1, files=())
        page = ready(browser, "/studies/jump/events")
        expect(page.locator("#filters [role=status]")).to_have_text("120 events so far")
        page.click("text=Show older events")
        expect(page.locator("#events li").last).to_contain_text("study created")
        expect(page.locator("text=Show older events")).to_be_hidden()
        browser.assert_calm()


class TestAbsence:
    def test_a_restarted_service_is_told_and_caught_up_with(self, browser, service, record):
        record.one()
        page = ready(browser, "/studies/jump")
        service.stop()
        expect(page.locator("#link")).to_have_attribute("data-state", "waiting")
        expect(page.locator("#banner")).to_contain_text("The service does not answer since", timeout=20000)
        service.start()
        record.store = service.store
        record.one()
        expect(page.locator("#link")).to_have_attribute("data-state", "live", timeout=30000)
        expect(page.locator("#banner")).to_be_hidden()
        expect(page.locator("#fact-trials")).to_have_text("2 of 24 done")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(2)

    def test_a_swapped_database_leaves_no_stale_rows(self, browser, service, record):
        for _ in range(3):
            record.one(iterations=1)
        page = ready(browser, "/studies/jump")
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(3)
        service.stop()
        service.start("another.db")
        Record(service.store, service.artifacts, "jump", target=9).begin().one(iterations=1)
        expect(page.locator("#fact-trials")).to_have_text("1 of 9 done", timeout=30000)
        expect(page.locator("#table tbody tr[data-number]")).to_have_count(1)

    def test_a_session_that_has_ended_leads_to_the_login_page(self, browser, service, record):
        page = ready(browser, "/studies/jump")
        page.context.clear_cookies()
        service.stop()
        service.start()
        page.wait_for_url(f"{browser.url}/login?next=%2Fstudies%2Fjump", timeout=30000)


class TestCraft:
    @pytest.mark.parametrize(
        "path", ["/", "/studies/jump", "/studies/jump/trials", "/studies/jump/trials/0", "/submit"]
    )
    def test_nothing_is_wider_than_a_phone(self, browser, record, path):
        record.one(iterations=3)
        browser.page.set_viewport_size({"width": 390, "height": 800})
        page = browser.open(path)
        page.wait_for_load_state("networkidle")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390

    def test_the_theme_can_be_chosen_and_stays(self, browser, record):
        page = ready(browser, "/studies/jump")
        page.click("#theme")
        ready(browser, "/studies/jump")
        assert page.evaluate("document.documentElement.dataset.theme") == "dark"
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 26)"

    @pytest.mark.parametrize("scheme", ["light", "dark"])
    def test_text_and_states_have_enough_contrast(self, chromium, service, record, scheme):
        """WCAG AA: 4.5 to 1 for every colour that text is set in, on both of the surfaces it stands on."""
        context = chromium.new_context(color_scheme=scheme)
        page = context.new_page()
        page.goto(f"{service.url}/login")
        names = ["ink", "soft", "accent", "complete", "running", "queued", "failed", "diverged", "infeasible"]
        style = page.evaluate_handle("getComputedStyle(document.documentElement)")
        colours = {
            name: style.evaluate("(style, name) => style.getPropertyValue(name).trim()", f"--{name}")
            for name in [*names, "paper", "sheet", "hover"]
        }
        context.close()
        poor = [
            (name, surface, round(contrast(colours[name], colours[surface]), 2))
            for name in names
            for surface in ("paper", "sheet", "hover")
            if contrast(colours[name], colours[surface]) < 4.5
        ]
        assert poor == []


def contrast(one, other):
    """Contrast ratio of two colours (WCAG 2.1, relative luminance)."""

    def luminance(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


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


class TestCluster:
    def test_they_come_and_go(self, browser, record):
        page = ready(browser, "/cluster")
        expect(page.locator("#idle")).to_be_visible()
        (trial,) = record.propose()
        attempt = record.start(trial)
        expect(page.locator("#workers tbody")).to_contain_text("default-0runner (process 99)")
        record.finish(attempt, trial, value=0.5, features=(0.1,))
        expect(page.locator("#idle")).to_be_visible()
        browser.assert_calm()


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
