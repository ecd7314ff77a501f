"""The accessibility checker axe-core, brought by npm under a lock file of its own; nothing of it is served."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from dashboards.vendor import npm_ci

HERE = Path(__file__).parent / "axe"
SCRIPT = HERE / "node_modules" / "axe-core" / "axe.min.js"


def source():
    """The checker as a script."""
    if not SCRIPT.is_file():
        with tempfile.TemporaryDirectory(prefix="halma-axe-") as scratch:
            for name in ("package.json", "package-lock.json", ".npmrc"):
                shutil.copy(HERE / name, scratch)
            npm_ci(Path(scratch))
            SCRIPT.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(Path(scratch) / "node_modules" / "axe-core" / "axe.min.js", SCRIPT)
    return SCRIPT.read_text(encoding="utf-8")


def complaints(page, script):
    """What is wrong with a page by WCAG 2.1 A and AA: rule, how grave, and the first element."""
    page.evaluate(script)
    found = page.evaluate(
        "axe.run(document, { runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa'], resultTypes: ['violations'] })"
    )
    return [
        (one["id"], one["impact"], node["target"], node["failureSummary"])
        for one in found["violations"]
        for node in one["nodes"][:3]
    ]
