"""Every page over studies that the product itself has run in this session: one for strategies, one for quality.

The server is shared, so no test here changes a study.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import expect

from services.auth import COOKIE, Gatekeeper
from tests.dashboards.axe_core import complaints, source
from tests.dashboards.conftest import TOKEN, Service, Watched, until

pytestmark = pytest.mark.browser

JUMPS = """
name: jumps
task:
  name: high_jump
  settings: {formulation: flight, feature: rotation}
search: {strategy: bds, trials: 5}
training:
  budget: {samples: 700}
  network: {hidden: [64, 32]}
seed: 3
"""
HOPS = """
name: hops
task: point_jump
search: {strategy: cmfbo, trials: 10}
training: {budget: {samples: 600}}
seed: 3
"""
VALLEY = """
name: valley
task: "valley:depth"
space: {rate: {type: float, low: 1.0e-5, high: 1.0e-1, log: true}}
search: {strategy: cmfbo, cost: 8000, first: [{rate: 1.0e-2}, {rate: 3.0e-4}]}
"""
VALLEY_TASK = """
import math

def depth(params, z):
    return z * (9 - (math.log10(params["rate"]) + 3) ** 2), None, int(1000 * z)
"""
HALMA = str(Path(sys.executable).parent / "halma")
SOFTWARE_GL = ["GPU stall due to ReadPixels", "GL_CLOSE_PATH_NV"]


@pytest.fixture(scope="module")
def product(tmp_path_factory):
    """A server over what `halma run` made."""
    folder = tmp_path_factory.mktemp("product")
    environment = {**os.environ, "HALMA_HOME": str(folder), "OMP_NUM_THREADS": "1"}
    (folder / "valley.py").write_text(VALLEY_TASK)
    for name, text in (("jumps", JUMPS), ("hops", HOPS), ("valley", VALLEY)):
        (folder / f"{name}.yaml").write_text(text)
        command = [HALMA, "run", f"{name}.yaml", "--inline"]
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr + done.stdout
    running = Service(folder, artifacts="halma.artifacts").start()
    yield running
    running.stop()


@pytest.fixture(scope="module")
def context(product, chromium):
    made = chromium.new_context(viewport={"width": 1280, "height": 900}, color_scheme="light", reduced_motion="reduce")
    made.add_cookies([{"name": COOKIE, "value": Gatekeeper(TOKEN).new_session(), "url": product.url}])
    yield made
    made.close()


@pytest.fixture
def viewer(context, product):
    watched = Watched(context, product.url)
    yield watched
    watched.page.close()


def ready(viewer, path):
    page = viewer.open(path)
    page.wait_for_selector("#link[data-state=live]")
    return page


def drawn(page, place):
    expect(page.locator(f"{place} svg").first).to_be_visible()


def test_the_list_shows_progress_strategies_cost_and_course(viewer):
    page = ready(viewer, "/")
    row = page.locator("tr[data-study=jumps]")
    for text in ("complete", "5 of 5 done", "0.7", "samples"):
        expect(row).to_contain_text(text)
    expect(row.locator("[data-label=Best]")).to_have_text(re.compile(r"^0\.\d+ m$"))
    expect(row.locator(".spark")).to_be_visible()
    strategies = int(row.locator("[data-label=Strategies]").inner_text())
    page.goto(f"{viewer.url}/studies/jumps")
    expect(page.locator("#gallery .strategy")).to_have_count(strategies)
    viewer.assert_calm()


def test_cards_show_pose_name_facing_height_and_trial_and_light_the_sphere(viewer):
    page = ready(viewer, "/studies/jumps")
    card = page.locator(".strategy").first
    for text in ("bar 0.7 m", "facing", "trial "):
        expect(card).to_contain_text(text)
    card.scroll_into_view_if_needed()
    until(lambda: card.locator("img").evaluate("image => image.naturalWidth") == 480)
    assert "," in card.locator("strong").inner_text()
    count = page.locator(".strategy").count()
    expect(page.locator("#distances tbody tr")).to_have_count(min(count, 8))
    card.hover()
    expect(page.locator("#behaviour .lit-mark")).to_have_count(1)
    page.focus("#behaviour")
    before = page.locator("#behaviour a circle").first.get_attribute("cx")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#behaviour a circle").first).not_to_have_attribute("cx", before)
    viewer.assert_calm()


def test_a_slice_shows_what_the_search_expects_and_follows_sliders_and_axes(viewer):
    page = ready(viewer, "/studies/jumps/search?output=novelty")
    expect(page.locator("#map .heatmaplayer image")).to_have_count(1)
    expect(page.locator("#unsure .heatmaplayer image")).to_have_count(1)
    expect(page.locator("#map .legendtext")).to_have_text(["finished", "next proposal"])
    first = page.locator("#map .heatmaplayer image").get_attribute("href")
    slider = page.locator("#sliders input[type=range]").first
    slider.fill("190")
    expect(page.locator("#map .heatmaplayer image")).not_to_have_attribute("href", first)
    assert "at=" in page.url
    page.select_option("#map-x", "v_z")
    expect(page.locator("#map .xtitle")).to_have_text("v_z (m/s)")
    expect(page.locator("#reasons tbody tr")).to_have_count(5)
    expect(page.locator("#reasons")).to_contain_text("furthest from every known behaviour")
    expect(page.locator("#reasons")).to_contain_text("acquisition")
    viewer.assert_calm()


def test_a_slice_of_one_parameter_is_a_line_with_its_band(viewer):
    page = ready(viewer, "/studies/valley/search")
    expect(page.locator("#map .legendtext")).to_have_text(["one deviation", "expected", "finished"])
    expect(page.locator("#map .xtitle")).to_have_text("rate")
    expect(page.locator("#map .ytitle")).to_have_text("value")
    expect(page.locator("#map .points path")).to_have_count(page.locator("#reasons tbody tr").count())
    expect(page.locator("#map-y")).to_be_hidden()
    expect(page.locator("#scale")).to_be_hidden()
    expect(page.locator("#unsure-panel")).to_be_hidden()
    expect(page.locator("#reasons")).to_contain_text("given by the study: tried before the search decides")
    viewer.assert_calm()


def test_difficulties_show_ladder_cost_and_lineage(viewer):
    page = ready(viewer, "/studies/hops/search")
    drawn(page, "#ladder")
    expect(page.locator("#costs .bars .point")).to_have_count(2)
    expect(page.locator("#lineage a")).to_have_count(10)
    assert page.locator("#lineage path").count() >= 3
    page.locator("#lineage a[data-number='9']").hover()
    accent = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--accent').trim()")
    assert page.locator(f"#lineage path[stroke='{accent}']").count() >= 1
    viewer.assert_calm()


def test_quality_shows_cost_importances_and_curves_over_each_other(viewer):
    page = ready(viewer, "/studies/hops/quality")
    expect(page.locator("#value-chart .xtitle")).to_have_text("samples spent (control steps)")
    expect(page.locator("#importance svg text", has_text="speed")).to_have_count(1)
    page.click("summary")
    expect(page.locator("#best-space")).to_contain_text("space:")
    page.fill("#overlay-trials", "3, 5, 8")
    page.keyboard.press("Enter")
    expect(page.locator("#overlay .legendtext")).to_have_text(["trial 3", "trial 5", "trial 8"])
    assert "curves=3%2C+5%2C+8" in page.url
    expect(page.locator("#lines polyline")).to_have_count(9)
    viewer.assert_calm()


def test_a_trial_tells_where_it_comes_from_its_log_and_the_command_that_repeats_it(viewer, product):
    page = ready(viewer, "/studies/hops/trials/9")
    expect(page.locator("main")).to_contain_text("starts from")
    expect(page.locator("a", has_text="trial 8")).to_have_count(1)
    page = ready(viewer, "/studies/jumps/trials/1")
    command = page.locator(".command code").inner_text()
    page.click("#log summary")
    expect(page.locator("#log pre")).not_to_have_text("Reading …")
    words = command.split()
    assert words[:4] == ["halma", "replay", "jumps", "1"]
    done = subprocess.run([HALMA, *words[1:]], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_reference_clip_stands_beside_a_trial_in_step(viewer, tmp_path):
    import pybullet_data

    page = viewer.open("/studies/jumps/trials/1")
    page.wait_for_selector("halma-replay[data-state=ready]")
    page.set_input_files("#clip", f"{pybullet_data.getDataPath()}/data/motions/humanoid3d_jump.txt")
    page.wait_for_selector("[data-beside='humanoid3d_jump.txt'] halma-replay[data-state=ready]")
    wrong = tmp_path / "wrong.txt"
    wrong.write_text("no clip")
    page.set_input_files("#clip", wrong)
    expect(page.locator("#beside-said")).to_contain_text('wrong.txt: clip: expected a motion clip (JSON with "Frames")')
    viewer.assert_calm(but=[*SOFTWARE_GL, "422"])


PAGES = [
    "/", "/submit", "/cluster", "/studies/jumps", "/studies/jumps/search", "/studies/hops/search",
    "/studies/hops/quality", "/studies/jumps/trials", "/studies/jumps/events", "/studies/jumps/file",
    "/studies/jumps/trials/1", "/studies/nobody",
]  # fmt: skip


@pytest.fixture(scope="module")
def axe():
    return source()


@pytest.mark.parametrize(("scheme", "paths"), [("light", PAGES), ("dark", PAGES[3:7])])
def test_no_page_has_an_accessibility_fault_that_a_checker_finds(viewer, axe, scheme, paths):
    viewer.page.emulate_media(color_scheme=scheme)
    found = {}
    for path in paths:
        page = viewer.open(path)
        if path != "/studies/nobody":
            page.wait_for_selector("#link[data-state=live], #submit")
            page.wait_for_timeout(400)
        if wrong := complaints(page, axe):
            found[path] = wrong
    assert found == {}


MOVING = """[...document.querySelectorAll("*")].filter((one) => {
  const style = getComputedStyle(one);
  return style.animationName !== "none" || style.transitionDuration.split(", ").some((time) => parseFloat(time) > 0);
}).length"""


def test_nothing_moves_by_itself_for_those_who_asked_for_less_motion(viewer):
    for path in ("/studies/jumps/trials/0", "/studies/jumps", "/"):
        page = ready(viewer, path)
        assert page.evaluate(MOVING) == 0
    page.emulate_media(reduced_motion="no-preference")
    assert page.evaluate(MOVING) > 0, "bars of progress glide for everybody else"


def test_nothing_of_these_pages_is_wider_than_a_phone(viewer):
    viewer.page.set_viewport_size({"width": 390, "height": 800})
    for path in PAGES:
        page = viewer.open(path)
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, path
