"""Whether what a study reports can be believed: each reported policy simulated again and judged by its task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from services.artifacts.port import ArtifactStore
from services.errors import ArtifactDamaged, BadInput, HalmaError
from services.replaying import POLICY
from services.report import Finding, findings, spec_of, strategy_name
from services.store.port import Store, StudyRow
from services.translate import job_of
from workers.contracts import BadJob, Job
from workers.registry import load_task


class AuditFailed(HalmaError):
    """Something that is reported does not pass its audit."""


class Judgement(Protocol):
    """What a task's audit found."""

    @property
    def passed(self) -> bool:
        """Whether every check passed."""

    def to_json(self) -> dict[str, Any]:
        """`{"passed", "checks": {name: {"found", "bound", "unit", "passed"}}}`; a check without a bound only tells."""


@runtime_checkable
class Audits(Protocol):
    """A task that can judge a stored policy."""

    def audit(self, job: Job, policy: bytes, rollouts: int) -> Judgement:
        """Judge it. `rollouts` episodes with noise tell how surely it succeeds. Raises `BadJob` where it can't be."""


@dataclass(frozen=True, slots=True)
class Audited:
    """One reported strategy under audit.

    Args:
        finding: the strategy.
        checks: by name, `{"found", "bound", "unit", "passed"}`; empty where it could not be judged.
        message: why it could not.
    """

    finding: Finding
    checks: Mapping[str, Mapping[str, Any]]
    message: str = ""

    @property
    def failures(self) -> list[str]:
        """Names of the checks that it did not pass."""
        return [name for name, check in self.checks.items() if not check["passed"]]

    @property
    def passed(self) -> bool:
        """Whether it was judged, and passed every check."""
        return not self.message and not self.failures

    def to_json(self) -> dict[str, Any]:
        """For scripts."""
        trial = self.finding.trial
        return {
            "trial": trial.number,
            "name": strategy_name(trial) or None,
            "value": trial.value,
            "passed": self.passed,
            "failures": self.failures,
            "message": self.message or None,
            "checks": {name: dict(check) for name, check in self.checks.items()},
        }


def audit_study(store: Store, artifacts: ArtifactStore, row: StudyRow, rollouts: int) -> Sequence[Audited]:
    """Judge everything that a study reports, best first.

    Raises:
        BadInput: the study's task has no audit.
    """
    spec = spec_of(row)
    try:
        task = load_task(spec.task.name)
    except BadJob as error:
        raise BadInput(f"audit: {error}") from None
    if not isinstance(task, Audits):
        raise BadInput(f"audit: expected a task that can judge its policies, found that {spec.task.name} can't")
    judged = []
    for finding in findings(row, store.history(row.id)):
        left = {artifact.name: artifact for artifact in store.artifacts(finding.trial.id)}
        if POLICY not in left:
            judged.append(Audited(finding, {}, f"expected its {POLICY}, found that it left none"))
            continue
        try:
            found = task.audit(job_of(spec, finding.trial), artifacts.read(left[POLICY]), rollouts)
        except (ArtifactDamaged, BadJob) as error:
            judged.append(Audited(finding, {}, str(error)))
            continue
        judged.append(Audited(finding, found.to_json()["checks"]))
    return judged
