"""The picture of all findings."""

from __future__ import annotations

import io

import pytest
from PIL import Image

from services.contact_sheet import CAPTION, GAP, TILE, Tile, draw


def picture(colour, size=(64, 48)):
    data = io.BytesIO()
    Image.new("RGB", size, colour).save(data, "PNG")
    return data.getvalue()


def test_tiles_stand_in_rows_in_their_order(tmp_path):
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200), (200, 200, 0), (0, 200, 200)]
    tiles = [Tile(picture(colour, TILE), f"{n}. facing", "trial") for n, colour in enumerate(colours, 1)]
    path = draw(tiles, tmp_path / "new" / "sheet.png")
    with Image.open(path) as sheet:
        assert sheet.size == (GAP + 3 * (TILE[0] + GAP), GAP + 2 * (TILE[1] + CAPTION + GAP))
        for n, colour in enumerate(colours):
            x = GAP + n % 3 * (TILE[0] + GAP) + TILE[0] // 2
            y = GAP + n // 3 * (TILE[1] + CAPTION + GAP) + TILE[1] // 2
            assert sheet.getpixel((x, y)) == colour


def test_pictures_of_other_shapes_keep_theirs(tmp_path):
    path = draw([Tile(picture((200, 0, 0), (1000, 100)), "wide", "")], tmp_path / "sheet.png")
    with Image.open(path) as sheet:
        middle = (GAP + TILE[0] // 2, GAP + TILE[1] // 2)
        assert sheet.getpixel(middle) == (200, 0, 0)
        assert sheet.getpixel((middle[0], GAP + 2)) != (200, 0, 0)


def test_long_captions_are_cut_to_the_tile(tmp_path):
    long = draw([Tile(picture((0, 0, 0)), "m" * 500, "m" * 500)], tmp_path / "long.png")
    with Image.open(long) as sheet:
        margin = sheet.crop((GAP + TILE[0], 0, sheet.width, sheet.height))
        assert len(margin.getcolors()) == 1, "nothing is written beside the tile"


def test_nothing_and_no_pictures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected at least one tile, found none"):
        draw([], tmp_path / "sheet.png")
    with pytest.raises(ValueError, match="expected a picture, found 3 bytes of something else"):
        draw([Tile(b"abc", "", "")], tmp_path / "sheet.png")
