"""Requests made from the API's own description, right ones and wrong ones: no answer may break the description.

Each operation of the OpenAPI description gets generated requests (schemathesis), half of them within the description
and half not; where a study or a trial is named, every second request names one that exists. An answer must not be a
5xx, and its status, type, headers and body must be what the description says.

    python benchmarks/fuzz_api.py [--requests 6000] [--seed 1]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import schemathesis
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

sys.path.insert(0, str(Path(__file__).parents[1]))

from services.api.assembly import create_api
from services.api.submission import submit_to
from services.artifacts.open import open_artifacts
from services.auth import Gatekeeper
from services.states import TrialState
from services.store.open import open_store
from tests.record import Record

TOKEN = "a-token-for-benchmarks"
CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
HOSTS = ("testserver", "localhost")
"""What requests without a network call this machine."""
NAMES = ("jump", "empty")
PATIENCE = 180.0
"""Seconds for an answer. The first look at a surrogate imports the searches: more than schemathesis' own limit of 10 s
was seen on a busy machine, and reported as a failure that didn't happen again."""
FILES = ("pose.png", "policy.safetensors")


@dataclass
class Fuzzed:
    """What came of it.

    Args:
        requests: how many were made, by operation.
        statuses: how many answers of each status.
        failures: what broke the description, one for each operation at most.
    """

    requests: Counter[str] = field(default_factory=Counter)
    statuses: Counter[int] = field(default_factory=Counter)
    failures: dict[str, str] = field(default_factory=dict)


def application(folder: Path) -> Any:
    """The API over a record in which everything occurs: finished, failed, running and queued trials, and none."""
    store, artifacts = open_store(folder / "halma.db"), open_artifacts(folder / "artifacts")
    record = Record(store, artifacts, "jump").begin()
    for number in range(10):
        record.one(iterations=2, files=None if number < 2 else ())
    record.one(iterations=1, state=TrialState.FAILED, message="it fell")
    record.report(record.start(record.propose()[0]), 1, **{"return": 0.5})
    record.propose(2)
    Record(store, artifacts, "empty").begin()
    return create_api(
        store, artifacts, gate=Gatekeeper(TOKEN), submit=submit_to(store), pools={"default": 2}, hosts=HOSTS
    )


def fuzz(app: Any, each: int, chance: int) -> Fuzzed:
    """Make `each` requests of either kind for each operation.

    Args:
        app: the API.
        each: requests within the description, and again as many that break it.
        chance: seed of the generator.
    """
    headers = {"authorization": f"Bearer {TOKEN}"}
    schema = schemathesis.openapi.from_asgi("/api/v1/openapi.json", app, headers=headers)
    found = Fuzzed()
    for result in schema.get_all_operations():
        operation = result.ok()
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            try:
                _one(operation, mode, each, chance, headers, found)
            except (Exception, BaseExceptionGroup) as error:  # noqa: BLE001  (whatever it is, it is the finding)
                told = "\n".join(f"{type(each).__name__}: {each}" for each in leaves(error))
                found.failures[f"{operation.label} ({mode.value})"] = told[:4000]
    return found


def leaves(error: BaseException) -> list[BaseException]:
    """The errors inside groups of them, which is what there is to read."""
    if isinstance(error, BaseExceptionGroup):
        return [leaf for each in error.exceptions for leaf in leaves(each)]
    return [error]


def _one(operation: Any, mode: GenerationMode, each: int, chance: int, headers: dict[str, str], found: Fuzzed) -> None:
    requests = operation.as_strategy(generation_mode=mode)
    count = 0

    @seed(chance)
    @settings(
        max_examples=each,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
    )
    @given(requests, st.booleans(), st.sampled_from(NAMES), st.integers(0, 14), st.sampled_from(FILES))
    def ask(case: Any, known: bool, study: str, number: int, file: str) -> None:
        nonlocal count
        if known:
            for name, value in {"study": study, "number": number, "name": file}.items():
                if name in (case.path_parameters or {}):
                    case.path_parameters[name] = value
        count += 1
        response = case.call(headers=headers, timeout=PATIENCE)
        found.requests[operation.label] += 1
        found.statuses[response.status_code] += 1
        case.validate_response(response, checks=CHECKS, headers=headers)

    try:
        ask()
    except Exception as error:
        # An operation that takes nothing has no request that breaks its description.
        if count == 0 and "Unsatisfiable" in type(error).__name__:
            return
        raise


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--requests", type=int, default=6000, help="at least so many")
    parser.add_argument("--seed", type=int, default=1)
    given_ = parser.parse_args()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="halma-fuzz-") as folder:
        app = application(Path(folder))
        found, chance = Fuzzed(), given_.seed
        while sum(found.requests.values()) < given_.requests and not found.failures:
            more = fuzz(app, 100, chance)
            found.requests += more.requests
            found.statuses += more.statuses
            found.failures |= more.failures
            chance += 1
    total = sum(found.requests.values())
    for label, number in sorted(found.requests.items()):
        print(f"{number:6d}  {label}")
    print("answers:", ", ".join(f"{status}: {number}" for status, number in sorted(found.statuses.items())))
    print(f"{total} requests to {len(found.requests)} operations in {time.perf_counter() - began:.0f} s, seed "
          f"{given_.seed}, load {os.getloadavg()[0]:.1f}: {len(found.failures)} failures")  # fmt: skip
    for label, message in found.failures.items():
        print(f"\n{label}\n{message}")
    sys.exit(1 if found.failures else 0)


if __name__ == "__main__":
    main()
