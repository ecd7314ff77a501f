"""Events in words, for `watch`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from services.cli.words import count, duration, first_line, number
from services.store.port import EventRow

METRICS = ("level", "success_rate", "return_mean")
"""The learner's figures that a line has room for, in this order."""


def event_line(event: EventRow) -> str | None:
    """One line for an event; None for those that only matter to programs."""
    words = _words(event.kind, event.payload)
    if words is None:
        return None
    who = "study" if event.trial is None else f"trial {event.trial}"
    return f"{event.at.astimezone().strftime('%H:%M:%S')}  {who}: {words}"


def metric_words(metrics: Mapping[str, Any]) -> str:
    """The figures people look at: `level 0.62, success_rate 0.48, return_mean 0.31`; others where there are none."""
    named = [name for name in METRICS if name in metrics] or sorted(metrics)[:3]
    return ", ".join(f"{name.replace('_', ' ')} {number(float(metrics[name]))}" for name in named)


def _words(kind: str, payload: Mapping[str, Any]) -> str | None:  # noqa: PLR0911 - one return a kind
    match kind:
        case "created":
            return "created"
        case "driven":
            return f"taken up by process {payload.get('pid')} on {payload.get('host')}"
        case "proposed":
            numbers = ", ".join(str(number) for number in payload.get("trials", []))
            return f"{payload.get('strategy')} proposes trial {numbers}" if numbers else "nothing more to propose"
        case "started":
            return f"starts (attempt {payload.get('attempt')}, {payload.get('worker')})"
        case "progress":
            figures = metric_words(payload.get("metrics", {}))
            samples = count(float(payload.get("samples", 0)))
            return f"iteration {payload.get('iteration')}, {samples} samples{', ' if figures else ''}{figures}"
        case "finished":
            return _finished(payload)
        case "lost" | "failed" | "preempted":
            return f"attempt {payload.get('attempt')} {kind}: {first_line(str(payload.get('reason', '')), 100)}"
        case "asked":
            return f"asked to {payload.get('wanted')}"
        case "extended":
            return "budget raised"
        case "released":
            reason = payload.get("reason")
            return f"{payload.get('state')}{f': {reason}' if reason else ''}"
        case "warning" | "refused":
            text = payload.get("reason") or payload.get("message") or ""
            return f"{kind}: {first_line(str(text), 100)}"
        case _:
            return kind


def _finished(payload: Mapping[str, Any]) -> str:
    cost = f"{count(float(payload.get('samples') or 0))} samples, {duration(float(payload.get('seconds') or 0))}"
    value = payload.get("value")
    words = f"{payload.get('state')}{'' if value is None else f', value {number(value)}'} ({cost})"
    message = first_line(str(payload.get("message") or ""), 100)
    return f"{words}: {message}" if message else words
