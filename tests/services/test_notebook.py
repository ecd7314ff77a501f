"""`docs/notebook.ipynb` runs from top to bottom, on the README's own study.

python tests/services/test_notebook.py     # run it and keep the outputs
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import nbclient
import nbformat
import pytest

from services.api.assembly import create_api
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper, load_or_create_token
from services.serving import announced
from services.settings import find_settings
from services.store.open import open_store

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"
LARGEST_OUTPUT = 250_000
"""Characters of one cell's output, pictures included."""


def block_after(words):
    """The block of code in the README that follows some words."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition(words)[2]
    return re.search(r"```\w+\n(.*?)```", text, re.DOTALL)[1]


@contextmanager
def throw(folder):
    """A home in which the README's `throw` has been run, and a service of it; its environment."""
    from tests.served import served

    (folder / "throw.py").write_text(block_after("In `throw.py`:"), encoding="utf-8")
    (folder / "throw.yaml").write_text(block_after("and in `throw.yaml`, beside it:"), encoding="utf-8")
    environment = {**os.environ, "HALMA_HOME": str(folder / "home"), "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    for name in ("HALMA_DB", "HALMA_TOKEN", "HALMA_ARTIFACTS", "HALMA_SERVER"):
        environment.pop(name, None)
    command = [sys.executable, "-c", "from services.cli import main; main()", "run", "throw.yaml", "--inline"]
    subprocess.run(command, env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL, timeout=300)
    settings = find_settings(environ=environment)
    store = open_store(settings.database)
    app = create_api(
        store, open_artifacts(settings.artifacts), gate=Gatekeeper(load_or_create_token(settings.home).token)
    )
    with served(app) as url, announced(settings, url):
        yield environment
    store.close()


def executed(folder):
    """The notebook with the outputs that it has now."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    with throw(folder) as environment:
        kernel = nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3", record_timing=False)
        kernel.execute(env=environment, cwd=str(folder))
    return notebook


def cells_of(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def sizes(notebook):
    return [len(str(output)) for cell in cells_of(notebook) for output in cell.outputs]


@pytest.mark.slow
# the kernel's own client still asks for an event loop where there is none
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning", "ignore::ResourceWarning")
def test_it_runs_from_top_to_bottom_and_shows_frames_and_figures(tmp_path):
    notebook = executed(tmp_path)
    kinds = [kind for cell in cells_of(notebook) for output in cell.outputs for kind in output.get("data", {})]
    assert kinds.count("text/html") >= 4, "frames"
    assert kinds.count("image/png") == 4, "three figures from the home, one from the service"
    assert max(sizes(notebook)) < LARGEST_OUTPUT


def test_the_outputs_that_are_kept_are_whole_small_and_name_no_place():
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    cells = cells_of(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not [output for cell in cells for output in cell.outputs if output.output_type == "error"]
    assert max(sizes(notebook)) < LARGEST_OUTPUT
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert not re.search(r"/(tmp|home|root|work)/", text)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as place:
        nbformat.write(executed(Path(place)), NOTEBOOK)
