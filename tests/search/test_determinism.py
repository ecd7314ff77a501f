"""Equal arguments give equal proposals in another process, whatever number of threads it has."""

import json
import os
import subprocess
import sys

import numpy as np
from search_cases import history_of, jump_space

from search import Candidate, Features, make_strategy, strategies

PROGRAM = """
import json, sys
import numpy as np
from search_cases import history_of, jump_space
from search import Candidate, Features, make_strategy
space = jump_space()
pending = [Candidate(space.from_unit(np.full(3, 0.3)))]
for name, settings in json.loads(sys.argv[1]):
    strategy = make_strategy(name, space, features=Features.circle(), settings=settings)
    found = strategy.propose(history_of(space, 25, seed=1), pending, 2, np.random.default_rng(5))
    print(json.dumps([[c.params, c.z, c.warm_start, c.info] for c in found]))
"""


def test_another_process_with_another_number_of_threads_proposes_the_same_to_the_last_bit():
    cases = [[info.name, {}] for info in strategies()] + [[name, {"variant": "published"}] for name in ("bds", "cmfbo")]
    threads = "1" if os.environ.get("OMP_NUM_THREADS") != "1" else "2"
    here = os.path.dirname(__file__)  # noqa: PTH120  # goes into a path list of the environment
    path = os.pathsep.join([here, os.path.dirname(os.path.dirname(here))])  # noqa: PTH120  # the same
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    command = [sys.executable, "-c", PROGRAM, json.dumps(cases)]
    out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    space = jump_space()
    pending = [Candidate(space.from_unit(np.full(3, 0.3)))]
    for (name, settings), line in zip(cases, out.splitlines(), strict=True):
        strategy = make_strategy(name, space, features=Features.circle(), settings=settings)
        found = strategy.propose(history_of(space, 25, seed=1), pending, 2, np.random.default_rng(5))
        assert json.loads(line) == json.loads(json.dumps([[c.params, c.z, c.warm_start, c.info] for c in found])), name
