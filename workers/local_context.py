"""A context in a plain folder, for debugging one job and for tests.

    run(job, LocalContext(Path("somewhere")))

The service has a context of its own, with leases and hashes; this one keeps the same promises to the job.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from safetensors import SafetensorError
from safetensors.numpy import load, save

from workers.contracts import BadJob, Checkpoint, Cost

KEEP = 2


class LocalContext:
    """Checkpoints, artifacts, metrics and log of one trial in one folder.

    Args:
        folder: made where it doesn't exist. `checkpoints/`, `artifacts/`, `metrics.jsonl`, `log.txt`.
        parent: folder of the parent trial, where there is one.
        stop: asked at each iteration boundary; never stops by default.
        echo: gets each log line too, e.g. `print`.
    """

    def __init__(
        self,
        folder: Path,
        *,
        parent: Path | None = None,
        stop: Callable[[], bool] = lambda: False,
        echo: Callable[[str], None] | None = None,
    ) -> None:
        self.folder, self.parent, self.stop, self.echo = folder, parent, stop, echo
        for name in ("checkpoints", "artifacts"):
            (folder / name).mkdir(parents=True, exist_ok=True)

    def report(self, iteration: int, metrics: Mapping[str, float], cost: Cost) -> None:
        """Append a line to `metrics.jsonl`."""
        line = {"iteration": iteration, "samples": cost.samples, "seconds": cost.seconds, "metrics": dict(metrics)}
        with (self.folder / "metrics.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")

    def reports(self) -> list[dict[str, object]]:
        """What has been reported, oldest first."""
        path = self.folder / "metrics.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def stop_requested(self) -> bool:
        """What `stop` says."""
        return self.stop()

    def save_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Write, flush and rename; the two newest stay."""
        state = {"iteration": checkpoint.iteration, "state": checkpoint.state}
        data = save(dict(checkpoint.tensors), {"halma.checkpoint": json.dumps(state)})
        folder = self.folder / "checkpoints"
        _write(folder / f"{checkpoint.iteration:08d}.safetensors", data)
        for old in sorted(folder.glob("*.safetensors"))[:-KEEP]:
            old.unlink()

    def load_checkpoint(self) -> Checkpoint | None:
        """The newest that can be read. A torn one is renamed `.torn`, and logged."""
        for path in sorted((self.folder / "checkpoints").glob("*.safetensors"), reverse=True):
            data = path.read_bytes()
            try:
                tensors = load(data)
                header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
                about = json.loads(header["__metadata__"]["halma.checkpoint"])
            except (SafetensorError, KeyError, ValueError):
                path.rename(path.with_suffix(".torn"))
                self.log(f"set aside a torn checkpoint: {path.name}")
                continue
            return Checkpoint(about["iteration"], tensors, about["state"])
        return None

    def save_artifact(self, name: str, data: bytes) -> None:
        """Write, flush and rename under `artifacts/`."""
        _write(self._artifact(self.folder, name), data)

    def artifact(self, name: str) -> bytes:
        """One of our own artifacts."""
        return self._artifact(self.folder, name).read_bytes()

    def parent_artifact(self, name: str) -> bytes:
        """One of the parent's. Raises `BadJob` where there is none."""
        if self.parent is None:
            raise BadJob(f"parent: expected its {name}, but this context was given no parent")
        path = self._artifact(self.parent, name)
        if not path.exists():
            raise BadJob(f"parent: expected its {name}, found none; start without a parent, or run the parent again")
        return path.read_bytes()

    def log(self, message: str) -> None:
        """Append a line to `log.txt`."""
        with (self.folder / "log.txt").open("a") as file:
            file.write(message + "\n")
        if self.echo is not None:
            self.echo(message)

    @staticmethod
    def _artifact(folder: Path, name: str) -> Path:
        if Path(name).name != name:
            raise BadJob(f"artifact: expected a plain file name, found {name!r}")
        return folder / "artifacts" / name


def _write(path: Path, data: bytes) -> None:
    """All of it or none of it."""
    temporary = path.with_suffix(path.suffix + ".new")
    with temporary.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
