"""What came of the faults, on file: one JSON line for each kind of fault of each study, and tables of them."""

from __future__ import annotations

import json
import subprocess
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

from arena import ROOT

SUMMED = ("faults", "lost", "duplicated", "stuck", "broken", "repeated")
LARGEST = ("most",)
HEADINGS = {
    "broken": "otherwise broken", "repeated": "iterations repeated", "most": "by one training after one fault",
}  # fmt: skip


def revision():
    """The newest commit of the code under test."""
    of_code = ["git", "log", "-1", "--format=%h", "--", "services", "search", "workers"]
    done = subprocess.run(of_code, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stdout.strip()


@dataclass
class Book:
    """Results in a file that only grows.

    Args:
        path: the file.
        revision: of the code whose results count; None for all.
    """

    path: Path
    revision: str | None

    def write(self, results):
        """Append results."""
        with self.path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps({"revision": self.revision, **result}) + "\n" for result in results)

    def results(self):
        """Those that count."""
        if not self.path.exists():
            return []
        found = [json.loads(line) for line in self.path.read_text(encoding="utf-8").splitlines()]
        return [result for result in found if self.revision in {None, result["revision"]}]

    def faults(self):
        """How many faults of each kind there have been on each database."""
        counts = Counter()
        for result in self.results():
            counts[result["kind"], result["database"]] += result["faults"]
        return counts

    def places(self):
        """The exact points that have had their turn, by kind and database."""
        places = defaultdict(set)
        for result in self.results():
            if "place" in result:
                places[result["kind"], result["database"]].add(result["place"])
        return places


def table(results, order):
    """What came of each kind of fault, as Markdown.

    Args:
        results: as on file.
        order: the kinds as they are to be listed.
    """
    sums = defaultdict(lambda: dict.fromkeys((*SUMMED, *LARGEST), 0))
    for result in results:
        for key in ((result["kind"], result["database"]), ("all", result["database"]), ("all", "both")):
            row = sums[key]
            for name in SUMMED:
                row[name] += len(result[name]) if name == "broken" else result[name]
            for name in LARGEST:
                row[name] = max(row[name], result[name])
    names = (*SUMMED, *LARGEST)
    place = {kind: number for number, kind in enumerate([*order, "all"])}
    lines = [
        f"| kind | database | {' | '.join(HEADINGS.get(name, name) for name in names)} |",
        f"| --- | --- |{' --- |' * len(names)}",
    ]
    for (kind, database), row in sorted(sums.items(), key=lambda item: (place[item[0][0]], item[0][1])):
        lines.append(f"| {kind} | {database} | {' | '.join(str(row[name]) for name in names)} |")
    # A kind that is tried and never happens proves nothing, and must not look as if it did.
    never = [kind for kind in order if not any(sums[key]["faults"] for key in list(sums) if key[0] == kind)]
    return "\n".join([*lines, "", f"Never happened: {', '.join(never) or 'none of them'}."])
