"""The 3-D replay in a real browser: the motion that the worker recorded, at the same moment, from the same side."""

from __future__ import annotations

import io
from base64 import b64decode

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.dashboards.conftest import until
from tests.dashboards.motion import files, thrown
from tests.record import Record
from workers.contracts import Job
from workers.local_context import LocalContext
from workers.physics.rendering import Size, render_frame
from workers.replay import Replay
from workers.run import run
from workers.tasks.high_jump.behaviour import over_the_bar

pytestmark = pytest.mark.browser

SOFTWARE_GL = ["GPU stall due to ReadPixels", "GL_CLOSE_PATH_NV"]
"""What Chromium says when a software renderer's pixels are read."""


@pytest.fixture
def record(service):
    made = Record(service.store, service.artifacts, "jump").begin()
    made.one(files=files(thrown()))
    return made


def opened(browser, path="/studies/jump/trials/0"):
    page = browser.open(path)
    page.wait_for_selector("halma-replay[data-state=ready]", timeout=90000)
    return page


def of(page, expression):
    """A property of the first replay."""
    return page.evaluate(f"document.querySelector('halma-replay').{expression}")


def test_it_opens_at_the_moment_over_the_bar(browser, record):
    page = opened(browser)
    assert of(page, "time") == pytest.approx(over_the_bar(thrown())[0], abs=1e-5)
    browser.assert_calm(but=SOFTWARE_GL)


def test_the_bodies_are_where_the_recording_has_them(browser, record):
    page = opened(browser)
    replay = thrown()
    for frame in (0, 33, 69):
        of(page, f"seek({frame} * document.querySelector('halma-replay').replay.step)")
        drawn = of(page, "stage.bodies.map((body) => [...body.position.toArray(), ...body.quaternion.toArray()])")
        recorded = np.hstack([replay.arrays["position"][frame], replay.arrays["orientation"][frame]])
        drawn, recorded = np.array(drawn), np.array(recorded)
        assert drawn[:, :3] == pytest.approx(recorded[:, :3], abs=1e-4)
        # A quaternion and its opposite are one rotation.
        assert np.abs(np.sum(drawn[:, 3:] * recorded[:, 3:], axis=1)) == pytest.approx(1, abs=1e-4)


def silhouette(picture):
    """Where a picture shows the athlete: its left and right limbs are orange and blue, and nothing else is."""
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    orange = (red - blue > 70) & (red - green > 45) & (green - blue > 15) & (red > 130)
    blues = (blue - red > 50) & (blue > 70)
    return orange, blues


@pytest.mark.parametrize("moment", ["first frame", "over the bar"])
def test_it_shows_what_bullet_renders_of_the_same_state(browser, record, moment):
    replay = thrown()
    page = opened(browser)
    time = 0.0 if moment == "first frame" else over_the_bar(replay)[0]
    size = (480, 360)
    # The canvas itself and not the page, whose layout scales it; read in the very task that drew it.
    url = page.evaluate(
        """([time, width, height]) => {
          const replay = document.querySelector("halma-replay");
          replay.stage.resize(width, height);
          replay.seek(time);
          replay.stage.home();
          replay.stage.draw();
          return replay.canvas.toDataURL("image/png");
        }""",
        [time, *size],
    )
    picture = Image.open(io.BytesIO(b64decode(url.partition(",")[2]))).convert("RGBA")
    white = Image.new("RGBA", picture.size, "white")
    ours = np.asarray(Image.alpha_composite(white, picture).convert("RGB").resize(size))
    bullets = np.asarray(Image.open(io.BytesIO(render_frame(replay, time, Size(*size)))).convert("RGB"))
    for mine, reference in zip(silhouette(ours), silhouette(bullets), strict=True):
        assert reference.sum() > 300
        centre, wanted = (np.argwhere(mask).mean(axis=0) for mask in (mine, reference))
        assert np.abs(centre - wanted).max() < 6, "the limbs are elsewhere"
        overlap = (mine & reference).sum() / (mine | reference).sum()
        assert overlap > 0.6, f"the silhouettes share {overlap:.2f}"


def test_contact_forces_are_arrows_where_the_body_is_touched(browser, service):
    Record(service.store, service.artifacts, "jump").begin().one(files=files(thrown(frames=130)))
    page = opened(browser)
    found = page.evaluate(
        """() => {
          const replay = document.querySelector("halma-replay");
          const { arrays, frames, bodies, step } = replay.replay;
          const told = [];
          for (let frame = 0; frame < frames; frame++) {
            const touched = [];
            for (let body = 0; body < bodies; body++) {
              const at = 3 * (frame * bodies + body);
              const force = Math.hypot(...arrays.contact_force.subarray(at, at + 3));
              if (force > 0.02 * replay.stage.weight) touched.push(body);
            }
            replay.seek(frame * step);
            const shown = replay.stage.arrows.flatMap((arrow, body) => (arrow.visible ? [body] : []));
            told.push([touched.join(), shown.join()]);
          }
          return told;
        }"""
    )
    assert all(touched == shown for touched, shown in found)
    assert any(touched for touched, _ in found), "the athlete lands on the mat"


def test_it_plays_to_its_end_and_stops(browser, record):
    page = opened(browser)
    page.select_option("halma-replay select", "0.1")
    page.click("halma-replay .play")
    expect(page.locator("halma-replay .play")).to_have_text("Pause")
    page.select_option("halma-replay select", "1")
    expect(page.locator("halma-replay .play")).to_have_text("Play", timeout=60000)
    assert of(page, "time") == pytest.approx(thrown().seconds, abs=1e-6)


def test_the_keyboard_moves_it_frame_by_frame(browser, record):
    page = opened(browser)
    page.focus("halma-replay canvas")
    page.keyboard.press("Home")
    assert of(page, "time") == 0
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert of(page, "time") == pytest.approx(2 / 120, abs=1e-6)
    page.keyboard.press("End")
    page.keyboard.press("b")
    assert of(page, "time") == pytest.approx(over_the_bar(thrown())[0], abs=1e-5)


def test_it_can_be_scrubbed(browser, record):
    page = opened(browser)
    page.fill("halma-replay input[type=range]", "0.25")
    assert of(page, "time") == pytest.approx(0.25)
    expect(page.locator("halma-replay .clock")).to_have_text("0.25 s")


def test_others_stand_beside_it_in_step(browser, record):
    record.one(files=files(thrown(spin=-2.0)))
    page = opened(browser)
    page.fill("#beside input", "1")
    page.click("#beside button")
    page.wait_for_selector("[data-beside='1'] halma-replay[data-state=ready]", timeout=90000)
    assert page.url.endswith("?beside=1")
    of(page, "seek(document.querySelector('halma-replay').crossing + 0.1)")
    other = "document.querySelector(\"[data-beside='1'] halma-replay\")"
    until(lambda: page.evaluate(f"{other}.time - {other}.crossing") == pytest.approx(0.1, abs=1e-6))
    opened(browser, "/studies/jump/trials/0?beside=1")
    expect(page.locator("[data-beside='1'] halma-replay[data-state=ready]")).to_have_count(1, timeout=90000)


def test_one_without_a_replay_can_not_stand_beside_it(browser, record):
    record.one()
    page = opened(browser)
    page.fill("#beside input", "1")
    page.click("#beside button")
    expect(page.locator("#beside-said")).to_have_text("Trial 1: This trial left no replay.")
    expect(page.locator("[data-beside]")).to_have_count(0)


def test_without_webgl_the_picture_is_shown_and_a_sentence_why(chromium, service, record, browser):
    browser.page.add_init_script(
        """
        const real = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
          return String(kind).startsWith("webgl") ? null : real.call(this, kind, ...rest);
        };
        """
    )
    page = browser.open("/studies/jump/trials/0")
    expect(page.locator("halma-replay .said")).to_contain_text("This browser has no WebGL", timeout=30000)
    until(lambda: of(page, "shadowRoot.querySelector('img').naturalWidth") == 480)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"nothing of the kind", "The file is not a replay."),
        (b"xx", "The file is too short to be a replay."),
        (thrown().to_bytes()[:-40], "The replay is cut short."),
    ],
)
def test_a_file_that_is_no_replay_is_told(browser, service, data, said):
    Record(service.store, service.artifacts, "jump").begin().one(files=[("replay.bin", data)])
    page = browser.open("/studies/jump/trials/0")
    expect(page.locator("halma-replay .said")).to_contain_text(said, timeout=30000)


def test_a_walk_has_no_bar_and_shows_the_walkers_own_bodies(browser, service, tmp_path):
    context = LocalContext(tmp_path)
    tiny = {"budget": {"samples": 40}, "network": {"hidden": [8]}, "ppo": {"environments": 2, "samples": 16}}
    run(Job("s", 0, "walker", {"thigh_length": 1.5}, 1, {"steps": 20, "training_steps": 8}, tiny, 0.3), context)
    data = context.artifact("replay.bin")
    walk = Replay.from_bytes(data)
    Record(service.store, service.artifacts, "walk").begin().one(files=[("replay.bin", data)])
    page = opened(browser, "/studies/walk/trials/0")
    assert of(page, "stage.bodies.length") == 9
    of(page, "seek(document.querySelector('halma-replay').duration)")
    drawn = np.array(of(page, "stage.bodies.map((body) => body.position.toArray())"))
    assert drawn == pytest.approx(walk.arrays["position"][-1], abs=1e-4)
    thigh = walk.header["bodies"].index("right_thigh")
    assert of(page, f"replay.header.shapes[{thigh}].size[1]") == pytest.approx(1.5 * 0.4)
    assert of(page, "shadowRoot.querySelector('.bar-button').hidden") is True
    metres = walk.arrays["com"][-1, 0]
    assert f"{metres:.1f} m along" in of(page, "shadowRoot.querySelector('.figures').textContent")
    browser.assert_calm(but=SOFTWARE_GL)
