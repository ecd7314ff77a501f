"""The example of the README runs as it is printed."""

import math
import re
from pathlib import Path

from search import Observation

README = Path(__file__).parents[2] / "README.md"


def test_the_example_of_the_search_alone_runs_as_printed():
    section = README.read_text().partition("## The search alone")[2]
    found = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert found
    program = found.group(1)
    assert len([line for line in program.splitlines() if line.strip()]) <= 11
    world = {"my_training": lambda params: math.remainder(params["omega_x"] + params["alpha"], 2 * math.pi)}
    exec(compile(program, str(README), "exec"), world)  # the README's own lines
    history = world["history"]
    assert len(history) == 10
    assert all(isinstance(o, Observation) and o.status == "complete" for o in history)
