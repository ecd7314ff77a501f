import io

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from workers.contracts import BadJob
from workers.physics.rendering import Size, render_frame, render_video

SMALL = Size(160, 120)


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def test_a_frame_shows_the_athlete_and_the_bar_in_their_colours(jump):
    picture = pixels(render_frame(jump, 0.2, SMALL))
    assert picture.shape == (120, 160, 3)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert ((red > 150) & (green > 120) & (blue < 90)).sum() > 30  # the yellow bar
    assert ((blue > red + 50) & (blue > green + 30)).sum() > 20  # the right limbs
    assert ((red > 150) & (green < red - 60) & (blue < 90)).sum() > 20  # the left limbs


def test_two_moments_look_different_and_one_moment_always_the_same(jump):
    early, late = render_frame(jump, 0.0, SMALL), render_frame(jump, 0.4, SMALL)
    assert np.abs(pixels(early) - pixels(late)).mean() > 1
    assert render_frame(jump, 0.0, SMALL) == early


def test_a_time_beyond_the_jump_shows_its_end(jump):
    assert render_frame(jump, 99.0, SMALL) == render_frame(jump, jump.seconds, SMALL)


def test_a_gif_plays_the_jump_in_slow_motion(jump):
    movie = Image.open(io.BytesIO(render_video(jump, kind="gif", slower=1.0, rate=20, size=SMALL)))
    moving = round(jump.seconds * 20)
    assert movie.size == (160, 120)
    assert 1 < movie.n_frames <= moving + 10
    total = 0
    for i in range(movie.n_frames):
        movie.seek(i)
        total += movie.info["duration"]
    assert total == pytest.approx(50 * (moving + 10), abs=50)


def test_an_mp4_has_all_its_pictures(jump, tmp_path):
    data = render_video(jump, kind="mp4", slower=1.0, rate=20, size=SMALL)
    assert data[4:8] == b"ftyp"
    path = tmp_path / "jump.mp4"
    path.write_bytes(data)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == round(jump.seconds * 20) + 10
    assert seconds == pytest.approx(count / 20, abs=0.06)


def test_other_kinds_of_video_are_refused(jump):
    with pytest.raises(BadJob, match="expected gif or mp4, found 'avi'"):
        render_video(jump, kind="avi")
