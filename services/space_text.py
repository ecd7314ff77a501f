"""A part of a space as the section of a study file that people paste into their next study."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from search import Angle, Categorical
from search.space import Parameter
from services.spec import as_written
from services.store.port import TrialRow


def space_yaml(parameters: Mapping[str, Parameter], best: TrialRow, before: int = 0) -> str:
    """A `space` section to paste into the next study, with the best value beside each parameter.

    Args:
        parameters: of the section.
        best: the trial it is around.
        before: how many trainings the trial's policy went through before its own; the value is theirs, too.
    """
    lines = [f"# around trial {best.number}: value {as_written(float(f'{best.value:.6g}'))}"]
    if before:
        others = "another trial" if before == 1 else f"{before} other trials"
        lines.append(f"# its policy had learnt in {others} before: from scratch the same setting may come to less")
    lines.append("space:")
    for name, parameter in parameters.items():
        value = best.params[name]
        shown = value if isinstance(value, str) else as_written(float(f"{value:.6g}"))
        lines.append(f"  {_scalar(name)}: {_parameter_yaml(parameter)}  # best: {shown}")
    return "\n".join(lines) + "\n"


def _parameter_yaml(parameter: Parameter) -> str:
    if isinstance(parameter, Angle):
        return "angle"
    if isinstance(parameter, Categorical):
        return f"{{type: categorical, choices: [{', '.join(_scalar(choice) for choice in parameter.choices)}]}}"
    kind = type(parameter).__name__.lower()
    log = ", log: true" if parameter.log else ""
    return f"{{type: {kind}, low: {as_written(parameter.low)}, high: {as_written(parameter.high)}{log}}}"


PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*")
MISREAD = frozenset({"true", "false", "null", "on", "off", "yes", "no", "nan", "inf"})
"""Words that YAML takes for something else."""


def _scalar(value: Any) -> str:
    """One value as YAML inside braces: quoted unless it is a bare word."""
    if isinstance(value, str) and (not PLAIN.fullmatch(value) or value.lower() in MISREAD):
        return json.dumps(value, ensure_ascii=False)  # a JSON string is a double-quoted YAML string
    return value if isinstance(value, str) else json.dumps(value)
