"""Studies on several hosts (`network.py`): cut off, killed, joined, while the study runs.

The head trains nothing. Two workers' hosts have one core each, share no file with the head, and find no module of the
task on their own: code travels to them, checkpoints and results travel back.
"""

from __future__ import annotations

import shutil
import time

from arena import HERE, ROOT, Arena
from network import PORT, Network
from ray_faults import LEASE, kill_driver
from ray_games import RayGame


class HostGame(RayGame):
    """A `RayGame` whose Ray was there before and goes on after the command.

    Args:
        folder: for everything.
        shape: the study.
        postgres: a server, or None for SQLite.
        more: what `RayGame` takes.
    """

    def __init__(self, folder, shape, postgres, rng, **more):
        notes = folder / "notes"
        notes.mkdir(parents=True)
        arena = Arena(folder / "study", shape, postgres, leases=10, notes=notes, path=(HERE / "hooks", ROOT))
        shutil.copy(HERE / "walk.py", arena.folder)
        super().__init__(arena, rng, **more)
        # Only where the submitter's own folder is: what the workers run has to have come from there.
        environment = {name: value for name, value in arena.environment.items() if name.startswith("HALMA_CHAOS_")} | {
            "PYTHONPATH": arena.python_path()
        }
        self.network = Network(notes, environment, arena.folder)

    def __enter__(self):
        self.network.__enter__()
        self.head = self.network.add()
        self.workers = [self.network.add(), self.network.add()]
        self.arena.environment |= self.network.environment | {"PYTHONPATH": self.arena.python_path()}
        self.arena.prefix = self.network.inside(self.head)
        self._start_all()
        return self

    def __exit__(self, *_):
        self.clear_away()
        self.network.__exit__()

    def _start_all(self):
        self.network.start_head(self.head)
        time.sleep(5.0)  # who comes before the head is up gives up
        for host in self.workers:
            self.network.start_worker(host, self.head)

    def start_command(self, *words):
        """The command on the head, joined to its cluster."""
        return self.arena.command(*words, "--ray-address", f"{self.network.address(self.head)}:{PORT}")

    def _running(self):
        """See to it that every host's Ray runs and somebody drives the study."""
        if not self.network.is_up(self.head):
            self.clear_away()
            for host in [self.head, *self.workers]:
                self.network.kill(host)
            self._start_all()
        for host in self.workers:
            if not self.network.is_up(host):
                self.network.kill(host)  # it was given up and has ended; its operator starts it again
                self.network.start_worker(host, self.head)
        super()._running()

    def to_the_end(self):
        """Let the study come to its end, and judge it; nothing may have run on the head."""
        verdict = super().to_the_end()
        ran_on = {row["host"] for row in self.arena.record().attempts if row["host"]}
        verdict.expect(
            ran_on <= self.network.workers, f"trained on {ran_on}, workers' hosts are {self.network.workers}"
        )
        return verdict


def cut_for(seconds):
    """A worker's host is cut off from the others for so long."""

    def fault(game):
        host = str(game.rng.choice(game.workers))
        game.network.cut(host)
        try:
            time.sleep(seconds)
        finally:
            game.network.heal(host)
        return True

    return fault


def kill_host(game):
    """A worker's host loses power, and another one joins in its place."""
    place = int(game.rng.integers(len(game.workers)))
    game.network.kill(game.workers[place])
    game.workers[place] = game.network.add()
    game.network.start_worker(game.workers[place], game.head)
    return True


def kill_head(game):
    """The head's host loses power, the driver with it; all of it is started again, and the study resumed."""
    game.clear_away()
    game.network.kill(game.head)
    return True


HOST_KINDS = {
    "network cut for a moment (hosts)": cut_for(1.0),
    "network cut beyond a lease (hosts)": cut_for(2 * LEASE),
    "network cut until a host is given up (hosts)": cut_for(25.0),
    "worker host killed, another joins (hosts)": kill_host,
    "head host killed (hosts)": kill_head,
    "driver killed (hosts)": kill_driver,
}
