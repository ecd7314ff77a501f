"""What people ask for in the browser: actions on a study, and new studies by paste, upload, drop and example."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from dashboards.examples import EXAMPLES
from services.api.submission import submit_to
from services.states import StudyState
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


class TestActions:
    def test_pausing_asks_first(self, browser, service, record):
        page = ready(browser, "/studies/jump")
        page.click("#actions [data-action=pause]")
        page.click("text=Keep as it is")
        assert service.store.study("jump").wanted == "run"
        page.click("#actions [data-action=pause]")
        page.click("#confirm-yes")
        expect(page.locator("#study-reason")).to_contain_text("pausing")
        assert service.store.study("jump").wanted == "pause"
        browser.assert_calm()

    def test_extending_raises_the_target_on_the_page(self, browser, service, record):
        page = ready(browser, "/")
        page.click("tr[data-study=jump] [data-action=extend]")
        page.fill("#confirm-number input", "6")
        page.click("#confirm-yes")
        expect(page.locator("tr[data-study=jump]")).to_contain_text("0 of 30 done")
        browser.assert_calm()

    def test_what_is_refused_is_told_in_the_dialog(self, browser, service, record):
        page = ready(browser, "/studies/jump")
        page.click("#actions [data-action=cancel]")
        record.end()
        with service.store.transaction() as change:
            change.delete_study("jump")
        page.click("#confirm-yes")
        expect(page.locator("#confirm-problem")).to_contain_text("expected the name of a study")
        browser.assert_calm(but=["404"])

    @pytest.mark.parametrize(
        ("state", "action", "wanted"),
        [(StudyState.PAUSED, "resume", "run"), (StudyState.CANCELLED, "resume", "run"), (None, "cancel", "cancel")],
    )
    def test_resuming_and_cancelling_ask_first(self, browser, service, record, state, action, wanted):
        if state is not None:
            with service.store.transaction() as change:
                change.ask("jump", "pause" if state is StudyState.PAUSED else "cancel")
            record.end(state)
        page = ready(browser, "/studies/jump")
        offered = page.locator("#actions [data-action]").evaluate_all("all => all.map((one) => one.dataset.action)")
        assert action in offered
        assert "extend" in offered or state is StudyState.CANCELLED
        page.click(f"#actions [data-action={action}]")
        expect(page.locator("#confirm-title")).to_have_text(f"{action.capitalize()} jump?")
        page.keyboard.press("Escape")
        assert service.store.study("jump").wanted != wanted
        page.click(f"#actions [data-action={action}]")
        page.click("#confirm-yes")
        expect(page.locator("#confirm")).to_be_hidden()
        assert service.store.study("jump").wanted == wanted
        browser.assert_calm()

    def test_a_budget_of_samples_is_extended_by_samples(self, browser, service):
        Record(service.store, service.artifacts, "costly").begin()
        with service.store._engine.begin() as connection:
            connection.exec_driver_sql("UPDATE studies SET target_trials = NULL, target_cost = 5000")
        page = ready(browser, "/studies/costly")
        page.click("#actions [data-action=extend]")
        expect(page.locator("#confirm-number")).to_contain_text("More samples")
        page.fill("#confirm-number input", "2500")
        page.click("#confirm-yes")
        expect(page.locator("#fact-trials")).to_contain_text("of 7.5\u202fk samples")
        assert service.store.study("costly").target_cost == 7500


class TestSubmission:
    def test_mistakes_are_shown_at_their_lines_and_a_good_file_runs(self, browser, service):
        page = browser.open("/submit")
        page.fill("#text", "name: pasted\ntask: point_jump\nsearch:\n  strategy: randon\n  trials: 0\n")
        page.click("#send")
        problems = page.locator("#problems li")
        expect(problems).to_have_count(2, timeout=30000)
        expect(problems.first).to_contain_text("line 4search.strategy:")
        expect(problems.last).to_contain_text("expected a number above 0, found 0")
        expect(page.locator("#lines [data-wrong]")).to_have_text(["4", "5"])
        assert service.store.studies() == []
        page.fill("#text", "name: pasted\ntask: point_jump\nsearch:\n  strategy: random\n  trials: 3\n")
        page.click("#send")
        page.wait_for_url(f"{browser.url}/studies/pasted")
        assert service.store.study("pasted").target_trials == 3
        browser.assert_calm(but=["422"])

    def test_a_file_can_be_opened(self, browser, tmp_path):
        file = tmp_path / "mine.yaml"
        file.write_text("name: from-a-file\n")
        page = browser.open("/submit")
        page.set_input_files("#upload", file)
        expect(page.locator("#text")).to_have_value("name: from-a-file\n")
        page.click("#send")
        expect(page.locator("#problems")).to_contain_text("search", timeout=30000)

    def test_a_study_can_be_cloned_as_a_new_file(self, browser, record):
        page = browser.open("/submit?study=jump")
        expect(page.locator("#text")).to_have_value(re.compile(r"^name: jump-2\ntask: \{name: high_jump\}\n"))


class TestExamples:
    @pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example["title"])
    def test_the_service_takes_each(self, service, example):
        assert submit_to(service.store)(example["text"], [], "study.yaml").name.startswith("my-")

    def test_one_is_put_into_the_editor_and_what_is_there_is_asked_about(self, browser):
        page = browser.open("/submit")
        page.select_option("#example", label=EXAMPLES[1]["title"])
        expect(page.locator("#text")).to_have_value(EXAMPLES[1]["text"])
        page.once("dialog", lambda dialog: dialog.dismiss())
        page.select_option("#example", label=EXAMPLES[0]["title"])
        expect(page.locator("#text")).to_have_value(EXAMPLES[1]["text"])
        page.once("dialog", lambda dialog: dialog.accept())
        page.select_option("#example", label=EXAMPLES[0]["title"])
        expect(page.locator("#text")).to_have_value(EXAMPLES[0]["text"])
        browser.assert_calm()

    def test_a_file_can_be_dropped(self, browser):
        page = browser.open("/submit")
        transfer = page.evaluate_handle(
            """() => {
              const transfer = new DataTransfer();
              transfer.items.add(new File(["name: dropped\\n"], "dropped.yaml", { type: "text/yaml" }));
              return transfer;
            }"""
        )
        page.dispatch_event("#editor", "drop", {"dataTransfer": transfer})
        expect(page.locator("#text")).to_have_value("name: dropped\n")


class TestStudyFile:
    def test_it_is_what_was_asked_for_and_can_be_downloaded(self, browser, record):
        page = ready(browser, "/studies/jump/file")
        with page.expect_download() as download:
            page.click("#download-file")
        assert download.value.suggested_filename == "jump.yaml"
        text = download.value.path().read_text()
        assert text.startswith("name: jump\ntask: {name: high_jump}\n")
        assert "omega_x: {type: float, low: -3.0, high: 3.0}" in text
        browser.assert_calm()
