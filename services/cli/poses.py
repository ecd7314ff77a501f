"""Commands about natural poses: `halma poses train`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from services.cli.session import AsJson, print_json, say
from services.cli.words import count, several
from services.errors import BadInput
from workers.contracts import BadJob

app = typer.Typer(help="Natural poses, learnt from motion clips.", no_args_is_help=True)
SUFFIXES = (".txt", ".json", ".bvh")


@app.callback()
def poses() -> None:
    """Natural poses, learnt from motion clips."""


@app.command()
def train(
    out: Annotated[Path, typer.Option("--out", "-o", help="The model's file (.safetensors).")],
    clips: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[CLIPS]...", help="DeepMimic clips, BVH files, or folders of them; default: the packaged clips."
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of weights, order and noise.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Train a pose autoencoder: which poses are natural?"""
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise BadInput(f"--out: expected a file in a folder that exists, found {out}")
    from workers.physics.clips import packaged  # noqa: PLC0415 - physics and torch take seconds to import
    from workers.poses.training import fit, gather, write  # noqa: PLC0415 - as above
    from workers.poses.training import train as train_poses  # noqa: PLC0415 - as above

    files = packaged() if not clips else _files(clips)
    try:
        found = gather(files)
        model = train_poses(found, seed=seed)
    except BadJob as error:
        raise BadInput(str(error)) from None
    try:
        write(model, out)
    except OSError as error:
        raise BadInput(f"--out: expected a file that can be written, found {out}: {error.strerror or error}") from None
    again = fit(model, found)
    if as_json:
        print_json(
            {
                "file": str(out.absolute()),
                "sha256": model.sha256(),
                "clips": len(files),
                "poses": len(found),
                "latent": model.latent,
                "position_error": again.position,
                "rotation_error": again.rotation,
            }
        )
        return
    say(
        f"Learnt {count(len(found))} poses of {several(len(files), 'clip')}: "
        f"{model.latent} latent dimensions hold 85 % of their variance."
    )
    say(f"Bodies come back within {100 * again.position:.1f} cm, joints within {again.rotation:.3f} rad.")
    say(f"Model: {out.absolute()}")
    say("Use it: task.settings {actions: pose, poses: " + str(out.absolute()) + "}")


def _files(given: Sequence[Path]) -> list[Path]:
    """The clips that were named, and those in folders that were, in a fixed order."""
    files: list[Path] = []
    for path in given:
        if not path.exists():
            raise BadInput(f"CLIPS: expected a motion clip or a folder of them, found nothing at {path}")
        inside = sorted(p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise BadInput(f"CLIPS: expected clips ({', '.join(SUFFIXES)}) in {path}, found none")
        files += inside
    return files
