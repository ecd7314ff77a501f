"""The table of a study of 50,000 trials: the service sorts and filters, and the browser holds what it shows.

The trials are copies of one that went through the port, made by one statement: 50,000 transitions would take minutes.
"""

from __future__ import annotations

import csv
import sqlite3
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import expect

from services.auth import COOKIE, Gatekeeper
from services.states import TrialState
from tests.dashboards.conftest import TOKEN, Service, Watched, until
from tests.record import Record

pytestmark = pytest.mark.browser

MANY = 50_000
FEW = 300
ROW = 30
COPIES = """
WITH RECURSIVE next(number) AS (SELECT 1 UNION ALL SELECT number + 1 FROM next WHERE number < :last)
INSERT INTO trials ({columns})
SELECT {values} FROM trials, next WHERE trials.study_id = :study AND trials.number = 0
"""
CHANGED = {
    "number": "next.number",
    "position": "next.number",
    # Golden-section steps: values spread over the unit interval, and no two are equal.
    "value": "(next.number * 0.618033988749) - CAST(next.number * 0.618033988749 AS INTEGER)",
    "state": "CASE WHEN next.number % 100 = 7 THEN 'diverged' ELSE 'complete' END",
}


def multiply(file, study, count):
    """Make `count` trials of a study's first one."""
    with sqlite3.connect(file) as database:
        columns = [row[1] for row in database.execute("PRAGMA table_info(trials)") if row[1] != "id"]
        values = [CHANGED.get(column, f"trials.{column}") for column in columns]
        statement = COPIES.format(columns=", ".join(columns), values=", ".join(values))
        database.execute(statement, {"last": count - 1, "study": study})
        database.execute("UPDATE studies SET trial_count = ? WHERE id = ?", (count, study))
    database.close()


def value(number):
    return number * 0.618033988749 % 1


@pytest.fixture(scope="module")
def crowded(tmp_path_factory, empty_database):
    """A server with a study of 50,000 trials and one of 300."""
    folder = tmp_path_factory.mktemp("many")
    running = Service(folder, empty_database).start()
    running.records = {}
    for name, count in (("many", MANY), ("few", FEW)):
        made = Record(running.store, running.artifacts, name, target=10**6).begin()
        made.one(iterations=1, value=0.5)
        multiply(folder / "halma.db", made.id, count)
        running.records[name] = made
    # What was read while the first trials were made would be of a history that nobody wrote through the port.
    running.stop()
    running.start()
    for made in running.records.values():
        made.store = running.store
    yield running
    running.stop()


@pytest.fixture
def viewer(crowded, chromium):
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    context.add_cookies([{"name": COOKIE, "value": Gatekeeper(TOKEN).new_session(), "url": crowded.url}])
    yield Watched(context, crowded.url)
    context.close()


def opened(viewer, path):
    page = viewer.open(path)
    page.wait_for_selector("#link[data-state=live]")
    page.wait_for_selector("#table tr[data-number]")
    return page


def scroll(page, top):
    page.evaluate("(top) => { document.getElementById('table').scrollTop = top; }", top)


def row(page, number):
    return page.locator(f"#table tr[data-number='{number}']")


SCROLL = """async (steps) => {
  const at = document.getElementById("table");
  let [made, most] = [0, 0];
  const body = at.querySelector("tbody");
  const watch = new MutationObserver((changes) => {
    for (const change of changes) made += change.addedNodes.length;
    most = Math.max(most, body.rows.length);
  });
  watch.observe(body, { childList: true });
  for (let step = 0; step < steps; step++) {
    at.scrollTop += 120;
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  }
  watch.disconnect();
  return [made, most];
}"""


def test_only_what_is_seen_is_asked_for_and_in_the_document(viewer):
    page = opened(viewer, "/studies/many/trials")
    expect(page.locator("#filters [role=status]")).to_have_text("50\u202f000 trials")
    assert page.evaluate("document.querySelector('#table').scrollHeight") == pytest.approx(MANY * ROW, abs=3 * ROW)
    expect(page.locator("#table table")).to_have_attribute("aria-rowcount", str(MANY + 1))
    expect(row(page, MANY - 1)).to_be_visible()
    for place in (0.5, 1.0, 0.25):
        top = place * MANY * ROW
        scroll(page, top)
        first = MANY - 1 - min(int(top / ROW), MANY - 20)
        expect(row(page, first - 1)).to_be_attached()
        assert page.locator("#table tbody tr").count() < 100
    asked = [urlsplit(url) for url in viewer.requests if "/window?" in url]
    assert all(int(parse_qs(one.query)["limit"][0]) <= 100 for one in asked)
    assert len(asked) <= 10
    assert not any(url.endswith("/table") for url in viewer.requests), "nobody loads 50,000 rows"
    viewer.assert_calm()


def test_scrolling_costs_the_same_whatever_the_number_of_trials(viewer):
    """Rows made while scrolling, and the most that the document held: the work that a frame has to do."""
    work = {}
    for name in ("few", "many"):
        page = opened(viewer, f"/studies/{name}/trials")
        work[name] = page.evaluate(SCROLL, 40)
    assert work["many"][1] <= work["few"][1] + 2 < 100
    # 40 steps of four rows each; a row of a block that is still on its way is made twice.
    assert work["many"][0] <= work["few"][0] * 1.5 < 600


def test_order_and_filters_are_the_service_s_and_the_address_keeps_them(viewer):
    page = opened(viewer, "/studies/many/trials")
    good = [n for n in range(MANY) if n % 100 != 7]
    page.click("#table th[data-sort=value]")
    by_value = sorted(good, key=lambda n: 0.5 if n == 0 else value(n), reverse=True)
    expect(page.locator("#table tbody tr[data-number]").first).to_have_attribute("data-number", str(by_value[0]))
    shown = page.locator("#table tbody tr[data-number]").evaluate_all(
        "all => all.map((one) => Number(one.dataset.number))"
    )
    assert shown == by_value[: len(shown)]
    page.fill("#filters input[type=search]", "value < 0.01 and state = complete")
    wanted = [n for n in by_value if value(n) < 0.01 and n]
    expect(page.locator("#filters [role=status]")).to_contain_text(f"{len(wanted)} of 50\u202f000 trials")
    expect(page.locator("#table tbody tr[data-number]").first).to_have_attribute("data-number", str(wanted[0]))
    page = opened(viewer, page.url.removeprefix(viewer.url))
    expect(page.locator("#table tbody tr[data-number]").first).to_have_attribute("data-number", str(wanted[0]))
    expect(page.locator("#table th[data-sort=value]")).to_have_attribute("aria-sort", "descending")
    with page.expect_download() as download:
        page.click("text=Download CSV")
    rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    assert [int(one["number"]) for one in rows] == wanted
    assert "seed" not in rows[0], "the columns are those of the table"
    viewer.assert_calm()


def test_what_happens_meanwhile_is_there_without_reloading_and_the_place_is_kept(viewer, crowded):
    record = crowded.records["few"]
    page = opened(viewer, "/studies/few/trials")
    count = len(crowded.store.trials(record.id))
    record.one(iterations=1, value=0.25)
    expect(row(page, count)).to_contain_text("0.25")
    scroll(page, 3000)
    expect(row(page, count - 101)).to_be_attached()
    read = f"#table tr[data-number='{count - 105}']"
    place = f'document.querySelector("{read}").getBoundingClientRect().top'
    before = page.evaluate(place)
    record.one(iterations=1, state=TrialState.DIVERGED, message="the return became NaN")
    expect(page.locator("#filters [role=status]")).to_have_text(f"{count + 2} trials")
    assert page.evaluate(place) == before, "what somebody reads stays where it is"
    asked = [url for url in viewer.requests if "/window?" in url and "offset=0" in url]
    assert len(asked) == 1, "in the plain order nothing is asked for again"
    page.click("#filters [data-state=complete]")
    expect(row(page, count + 1)).to_contain_text("the return became NaN")
    until(lambda: page.locator("#table .state[data-state=complete]").count() == 0)
    viewer.assert_calm()


def test_a_trial_that_starts_and_ends_moves_nothing_on_the_page(viewer, crowded):
    record = crowded.records["few"]
    page = opened(viewer, "/studies/few/trials")
    top = "document.getElementById('table').getBoundingClientRect().top"
    before = page.evaluate(top)
    (trial,) = record.propose()
    attempt = record.start(trial)
    expect(page.locator("#fact-running")).to_have_text("1 running")
    assert page.evaluate(top) == before
    record.finish(attempt, trial, value=0.25, features=(1.5,))
    expect(page.locator("#fact-running")).to_have_text("")
    assert page.evaluate(top) == before
    viewer.assert_calm()


def test_columns_do_not_move_while_somebody_scrolls(viewer):
    page = opened(viewer, "/studies/many/trials")
    edges = "[...document.querySelectorAll('#table th')].map((th) => Math.round(th.getBoundingClientRect().left))"
    before = page.evaluate(edges)
    for top in (9000, 300_000, 0):
        scroll(page, top)
        expect(row(page, MANY - 1 - top // ROW - 1)).to_be_attached()
        assert page.evaluate(edges) == before
