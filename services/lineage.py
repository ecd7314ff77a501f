"""Who was warm-started from whom: the lines of policies in a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from services.store.port import TrialRow


def line_of(trial: int, parents: Mapping[int, int | None]) -> list[int]:
    """Numbers from the trial that began from scratch down to `trial`, each started from the one before it."""
    line = [trial]
    while (parent := parents.get(line[-1])) is not None:
        line.append(parent)
    return line[::-1]


def began_anew(trial: TrialRow) -> bool:
    """Whether it took nothing but its parent's statistics, since its networks have other sizes."""
    taken = trial.details.get("warm_start")
    return isinstance(taken, Mapping) and taken.get("networks") is False


def learnt_before(trial: TrialRow, trials: Sequence[TrialRow]) -> int:
    """How many of `trials` its networks had learnt in before they came to it."""
    parents = {each.number: None if began_anew(each) else each.warm_start for each in (*trials, trial)}
    return len(line_of(trial.number, parents)) - 1


def lineage_words(trials: Sequence[TrialRow]) -> str | None:
    """`3 of 8 trials started from another's policy; the longest line: 0 → 2 → 7`; None where none did.

    A trial's parent always has a smaller number, so that lines end.
    """
    parents = {trial.number: trial.warm_start for trial in trials}
    started = [number for number, parent in parents.items() if parent is not None]
    if not started:
        return None
    longest = max((line_of(number, parents) for number in started), key=len)
    shown = " → ".join(map(str, longest))
    return f"{len(started)} of {len(trials)} trials started from another's policy; the longest line: {shown}"
