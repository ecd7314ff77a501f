"""A pose model at rest and at work: safetensors in and out, from latent vectors to poses in plain numpy."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from workers.contracts import JSON, BadJob
from workers.learning.policy import Layers, forward
from workers.physics.kinematics import skeleton
from workers.physics.rotations import Array
from workers.poses import encoding

FORMAT = 1
_METADATA_KEY = "halma.poses"


@dataclass(frozen=True, slots=True)
class PoseModel:
    """A pose autoencoder (P-VAE; Yin et al. 2021, section 5.1), trained.

    Args:
        latent: its dimension, L.
        mean, scale: of the encoded poses ``[144]``; the networks see (x - mean) / scale.
        encoder: 144 -> 2 L, mean and log variance.
        decoder: L -> 144.
        about: how it was trained, for people.
    """

    latent: int
    mean: Array
    scale: Array
    encoder: Layers
    decoder: Layers
    about: Mapping[str, JSON]

    def decode(self, latent: NDArray[Any]) -> Array:
        """Poses ``[n, 28]`` of latent vectors ``[n, L]``."""
        out = forward(self.decoder, np.asarray(latent, np.float32), "tanh")
        return encoding.decode(out * self.scale + self.mean)

    def encode(self, pose: NDArray[Any]) -> Array:
        """Means ``[n, L]`` of the latent vectors of poses ``[n, 28]``."""
        x = ((encoding.encode(pose) - self.mean) / self.scale).astype(np.float32)
        return forward(self.encoder, x, "tanh")[:, : self.latent].astype(np.float64)

    def to_bytes(self) -> bytes:
        """safetensors; equal models give equal bytes."""
        tensors: dict[str, NDArray[Any]] = {"mean": self.mean, "scale": self.scale}
        for name, layers in (("encoder", self.encoder), ("decoder", self.decoder)):
            for i, (weight, bias) in enumerate(layers):
                tensors |= {f"{name}.{i}.weight": np.ascontiguousarray(weight), f"{name}.{i}.bias": bias.copy()}
        about = {
            "format": FORMAT,
            "latent": self.latent,
            "skeleton": list(skeleton().names),
            "depth": len(self.decoder),
            "about": dict(self.about),
        }
        return save(tensors, {_METADATA_KEY: json.dumps(about, sort_keys=True)})

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "poses") -> PoseModel:
        """What `to_bytes` gave. Raises `BadJob` where it is something else, or of another skeleton."""
        try:
            tensors = load(data)
            header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])  # the format's own layout
            about = json.loads(header["__metadata__"][_METADATA_KEY])
            if about["format"] != FORMAT:
                raise BadJob(f"{where}: expected a pose model of format {FORMAT}, found format {about['format']}")
            _check_skeleton(where, about["skeleton"])
            encoder, decoder = (
                [(tensors[f"{name}.{i}.weight"], tensors[f"{name}.{i}.bias"]) for i in range(about["depth"])]
                for name in ("encoder", "decoder")
            )
            mean, scale = tensors["mean"], tensors["scale"]
            shapes = (mean.shape, scale.shape, decoder[0][0].shape[0], decoder[-1][1].shape)
            if shapes != ((encoding.SIZE,), (encoding.SIZE,), about["latent"], (encoding.SIZE,)):
                raise BadJob(f"{where}: expected a pose model of {encoding.SIZE} numbers a pose, found other sizes")
            return cls(about["latent"], mean, scale, encoder, decoder, about["about"])
        except (SafetensorError, KeyError, IndexError, TypeError, ValueError) as error:
            raise BadJob(
                f"{where}: expected a pose model written by `halma poses train`, found something else ({error})"
            ) from error

    @classmethod
    def read(cls, path: Path) -> PoseModel:
        """The model in a file. Raises `BadJob`."""
        try:
            data = path.read_bytes()
        except OSError as error:
            raise BadJob(f"{path}: expected a pose model, found nothing to read ({error.strerror})") from None
        return cls.from_bytes(data, str(path))

    def sha256(self) -> str:
        """Hash of everything, hexadecimal."""
        return hashlib.sha256(self.to_bytes()).hexdigest()


def _check_skeleton(where: str, found: list[str]) -> None:
    wanted = skeleton().names
    if tuple(found) == wanted:
        return
    missing = [name for name in wanted if name not in found]
    extra = [name for name in found if name not in wanted]
    what = f"missing {', '.join(missing)}" if missing else f"with {', '.join(extra) or 'another order'}"
    raise BadJob(f"{where}: expected a pose model of the athlete's skeleton, found one of another, {what}")
