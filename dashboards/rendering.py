"""Templates to answers."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

import pydantic_core
from fastapi import Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from dashboards import words
from dashboards.vendor import STAMP
from services.version import halma_version

HERE = Path(__file__).parent


def as_json(value: Any) -> Markup:
    """A value for a JSON data block of a page: nothing in it can end the block."""
    text = pydantic_core.to_json(value).decode()
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))  # noqa: S704  (escaped here)


@cache
def static_root() -> str:
    """Where scripts and styles are served: their content is in the path, so that a browser may keep them for good."""
    digest = hashlib.sha256()
    for path in sorted([*(HERE / "static").glob("*.*"), HERE / "static" / "vendor" / STAMP]):
        if path.is_file():
            digest.update(path.name.encode() + path.read_bytes())
    return f"/static/{digest.hexdigest()[:12]}"


@cache
def environment() -> Environment:
    """The templates, escaping everything, and failing on names that aren't there."""
    env = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters.update(
        number=words.number,
        amount=words.amount,
        duration=words.duration,
        size=words.size,
        moment=words.moment,
        glyph=words.glyph,
        feature=words.feature,
        listing=words.listing,
        result=words.result,
        as_json=as_json,
    )
    env.globals.update(version=halma_version(), static=static_root())
    return env


def page(request: Request, template: str, status: int = 200, **values: Any) -> HTMLResponse:
    """A rendered page. Called from plain functions, so that rendering never holds the event loop."""
    html = (
        environment()
        .get_template(template)
        .render(path=request.url.path, missing_libraries=request.app.state.missing_libraries, **values)
    )
    return HTMLResponse(html, status)
