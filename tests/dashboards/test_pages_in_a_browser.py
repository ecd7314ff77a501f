"""The pages in a real browser, over a real server and a real record: what is not about one study."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from services.auth import COOKIE
from services.states import TrialState
from tests.dashboards.conftest import TOKEN, log_in
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


def contrast(one, other):
    """Contrast ratio of two colours (WCAG 2.1, relative luminance)."""

    def luminance(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


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
