"""Training a pose autoencoder: a beta-VAE (Higgins et al. 2017) with the settings of Yin et al. 2021, section 5.1.

Glossary:

    x       an encoded pose, standardised
    mu, s   mean and log variance of its latent vector
    beta    weight of the divergence from the prior
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from workers.contracts import BadJob
from workers.learning.networks import Network
from workers.physics import clips, rotations
from workers.physics.kinematics import joint_rotations, skeleton
from workers.physics.rotations import Array
from workers.poses import encoding
from workers.poses.bvh import read_bvh
from workers.poses.model import FORMAT, PoseModel

BETA = 1e-5
HIDDEN = (256, 256)
RATE = 1e-4
MINIBATCH = 128
EPOCHS = 80
SHARE = 0.85
"""The latent dimension is the number of principal components with this share of the poses' variance."""
LEAST_POSES = 100


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a model gives back the poses it learnt.

    Args:
        position: mean distance of the bodies' centres of mass, relative to the root, m.
        rotation: mean angle of the joints' rotations, rad.
    """

    position: float
    rotation: float


def poses_of(path: Path) -> Array:
    """The poses ``[n, 28]`` of a clip: BVH by its suffix, the DeepMimic form otherwise. Raises `BadClip`."""
    return (read_bvh(path) if path.suffix.lower() == ".bvh" else clips.read(path)).pose


def train(poses: Array, *, seed: int = 0, epochs: int = EPOCHS, latent: int | None = None) -> PoseModel:
    """A pose model of these poses; the same poses and seed give the same model, bit for bit.

    Args:
        poses: ``[n, 28]``.
        seed: of weights, order and noise.
        epochs: passes over the poses.
        latent: dimension; None: computed from the variance of the poses.

    Raises `BadJob` where there are too few poses to learn from, or the training diverges.
    """
    if len(poses) < LEAST_POSES:
        raise BadJob(f"poses: expected at least {LEAST_POSES} poses to learn from, found {len(poses)}; give more clips")
    torch.set_num_threads(1)
    encoded = encoding.encode(poses)
    size = latent or encoding.latent_dimension(encoded, SHARE)
    mean, scale = encoded.mean(0), encoded.std(0)
    scale = np.where(scale > 1e-4, scale, 1.0)  # what never moves is not blown up: a hinge has constant rotations
    rng = np.random.default_rng(seed)
    encoder = Network("encoder", (encoding.SIZE, *HIDDEN, 2 * size), "tanh", rate=RATE, weight_decay=0.0, rng=rng)
    decoder = Network("decoder", (size, *HIDDEN, encoding.SIZE), "tanh", rate=RATE, weight_decay=0.0, rng=rng)
    x = torch.tensor(((encoded - mean) / scale).astype(np.float32))
    loss = torch.zeros(())
    for _ in range(epochs):
        order = torch.from_numpy(rng.permutation(len(x)))
        noise = torch.tensor(rng.standard_normal((len(x), size), np.float32))
        for start in range(0, len(x), MINIBATCH):
            batch = x[order[start : start + MINIBATCH]]
            out = encoder(batch)
            mu, s = out[:, :size], out[:, size:]
            z = mu + (0.5 * s).exp() * noise[start : start + MINIBATCH]
            # Kingma and Welling 2014, appendix B: the divergence from a standard normal distribution
            divergence = -0.5 * (1 + s - mu.square() - s.exp()).sum(1).mean()
            loss = (decoder(z) - batch).square().mean() + BETA * divergence
            for network in (encoder, decoder):
                network.gradient.zero_()
            loss.backward()  # type: ignore[no-untyped-call] # torch annotates its arguments, not its result
            for network in (encoder, decoder):
                network.step(grad_norm=np.inf)
    if not (encoder.finite() and decoder.finite()):
        raise BadJob("poses: expected weights that are finite after the training, found NaN; are the clips sound?")
    about = {"poses": len(poses), "epochs": epochs, "seed": seed, "beta": BETA, "loss": float(loss.detach())}
    return PoseModel(size, mean, scale, encoder.snapshot(), decoder.snapshot(), about)


def fit(model: PoseModel, poses: Array) -> Fit:
    """How well `model` gives back poses ``[n, 28]``."""
    again = model.decode(model.encode(poses))
    body, n = skeleton(), len(poses)
    root, still = np.zeros((n, 3)), np.tile(rotations.IDENTITY, (n, 1))
    gaps = np.linalg.norm(
        body.forward(poses, root, still).position - body.forward(again, root, still).position, axis=-1
    )
    turns = [joint_rotations(each, body.hinges) for each in (poses, again)]
    return Fit(float(gaps[:, 1:].mean()), float(rotations.angle_between(*turns).mean()))


def default_model() -> PoseModel:
    """The model of the packaged clips, trained on first use (seconds) and kept in `HALMA_HOME`."""
    paths = clips.packaged()
    digest = hashlib.sha256(f"{FORMAT}/{EPOCHS}/{SHARE}".encode())
    for path in paths:
        digest.update(path.read_bytes())
    home = Path(os.environ.get("HALMA_HOME") or "~/.halma").expanduser().absolute()
    file = home / "poses" / f"default-{digest.hexdigest()[:16]}.safetensors"
    if file.exists():
        return PoseModel.read(file)
    model = train(gather(paths))
    write(model, file)
    return model


def gather(paths: Sequence[Path]) -> Array:
    """All poses of some clips ``[n, 28]``. Raises `BadClip`."""
    return np.concatenate([poses_of(path) for path in paths])


def write(model: PoseModel, file: Path) -> None:
    """All of it or nothing, though others write the same file at the same time. Raises `OSError`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.{os.getpid()}.{time.monotonic_ns()}")
    try:
        temporary.write_bytes(model.to_bytes())
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)
