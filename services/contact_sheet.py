"""One picture of all that a study found: each finding's `pose.png` in a tile, with a caption below."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError

POSE = "pose.png"
"""Name of the artifact that shows what a policy does."""

TILE = (320, 240)
CAPTION = 40
GAP = 12
PAPER, INK, DIM = (250, 249, 246), (30, 30, 34), (110, 110, 118)


@dataclass(frozen=True, slots=True)
class Tile:
    """A picture with two lines below it.

    Args:
        picture: PNG (or another format that Pillow reads).
        title, caption: the two lines.
    """

    picture: bytes
    title: str
    caption: str


def draw(tiles: Sequence[Tile], path: Path) -> Path:
    """Draw the tiles in rows as square as they go, and save them as PNG.

    Args:
        tiles: at least one.
        path: where to; its folder is made.

    Raises:
        ValueError: no tiles, or a picture that is none.
        OSError: the picture can't be saved there.
    """
    if not tiles:
        raise ValueError("expected at least one tile, found none")
    columns = min(len(tiles), max(1, math.ceil(math.sqrt(len(tiles)))))
    rows = math.ceil(len(tiles) / columns)
    width, height = TILE[0], TILE[1] + CAPTION
    sheet = Image.new("RGB", (GAP + columns * (width + GAP), GAP + rows * (height + GAP)), PAPER)
    pen = ImageDraw.Draw(sheet)
    title_font, caption_font = ImageFont.load_default(15), ImageFont.load_default(12)
    for index, tile in enumerate(tiles):
        x = GAP + index % columns * (width + GAP)
        y = GAP + index // columns * (height + GAP)
        sheet.paste(_fitted(tile.picture), (x, y))
        pen.text((x + 2, y + TILE[1] + 3), _cut(tile.title, title_font, width), fill=INK, font=title_font)
        pen.text((x + 2, y + TILE[1] + 22), _cut(tile.caption, caption_font, width), fill=DIM, font=caption_font)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, format="PNG")
    return path


def _fitted(data: bytes) -> Image.Image:
    """The picture, scaled into a tile, on its own paper."""
    try:
        picture = Image.open(io.BytesIO(data)).convert("RGB")
    except UnidentifiedImageError:
        raise ValueError(f"expected a picture, found {len(data)} bytes of something else") from None
    picture.thumbnail(TILE)
    tile = Image.new("RGB", TILE, PAPER)
    tile.paste(picture, ((TILE[0] - picture.width) // 2, (TILE[1] - picture.height) // 2))
    return tile


def _cut(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    """The text, shortened until it fits."""
    if font.getlength(text) <= width - 4:
        return text
    while text and font.getlength(f"{text}...") > width - 4:
        text = text[:-1]
    return f"{text}..."
