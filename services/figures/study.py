"""All figures of a study: drawn, and written to a folder or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from services.errors import BadInput
from services.figures.behaviours import draw_behaviour
from services.figures.cost import draw_cost
from services.figures.curves import draw_curves
from services.figures.difficulty import draw_ladder
from services.figures.importance import draw_importance
from services.figures.parameters import draw_parallel, draw_parameters
from services.figures.shown import Shown
from services.figures.style import NotApplicable, encode, style
from services.figures.surrogate import draw_slice

FIGURES: Mapping[str, Callable[[Shown], Figure]] = {
    "cost": draw_cost,
    "behaviour": draw_behaviour,
    "ladder": draw_ladder,
    "parallel": draw_parallel,
    "importance": draw_importance,
    "curves": draw_curves,
    "parameters": draw_parameters,
    "slice": draw_slice,
}
"""What can be drawn of a study, by name."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """What came of drawing a study.

    Args:
        figures: by name.
        left_out: names of those that don't apply, with the reason.
    """

    figures: Mapping[str, Figure]
    left_out: Mapping[str, str]


def draw(shown: Shown, names: Sequence[str] = tuple(FIGURES)) -> Drawn:
    """Draw a study.

    Args:
        shown: the study.
        names: of `FIGURES`.
    """
    figures: dict[str, Figure] = {}
    left_out: dict[str, str] = {}
    with style():
        for name in names:
            try:
                figures[name] = FIGURES[name](shown)
            except NotApplicable as reason:
                left_out[name] = str(reason)
    return Drawn(figures, left_out)


def write(drawn: Drawn, folder: Path, form: str) -> list[Path]:
    """Write the figures to a folder, which is made where there is none; files of the same name are replaced.

    Args:
        drawn: the figures.
        folder: where to.
        form: `svg`, `pdf` or `png`.

    Raises:
        BadInput: nothing can be written there. What was written of this call is removed again.
    """
    # All of it is encoded before anything is written.
    files = {folder / f"{name}.{form}": encode(figure, form) for name, figure in drawn.figures.items()}
    if in_the_way := next((path for path in files if path.is_dir()), None):
        raise BadInput(f"--out: expected a folder that can be written, found the folder {in_the_way} in the way")
    fresh = {path: path.with_name(f".{path.name}.new") for path in files}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, data in files.items():
            fresh[path].write_bytes(data)
        for path in files:
            fresh[path].replace(path)
    except OSError as error:
        for path in fresh.values():
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
        raise BadInput(
            f"--out: expected a folder that can be written, found {folder}: {error.strerror or error}"
        ) from None
    return list(files)
