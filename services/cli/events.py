"""Events in words, for `watch`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from services.cli.words import count, duration, first_line, number, value_of
from services.store.port import EventRow

METRICS = {"level": "level", "success_rate": "success", "return_mean": "return"}
"""The learner's figures that a line has room for, in this order, and what the line calls them."""


def event_line(event: EventRow) -> str | None:
    """One line for an event; None for those that only matter to programs."""
    words = _words(event.kind, event.payload)
    if words is None:
        return None
    who = "study" if event.trial is None else f"trial {event.trial}"
    return f"{event.at.astimezone().strftime('%H:%M:%S')}  {who}: {words}"


def metric_words(metrics: Mapping[str, Any]) -> str:
    """The figures people look at: `level 0.62, success 0.48, return 0.31`; others where there are none of these."""
    named = [name for name in METRICS if name in metrics] or sorted(metrics)[:3]
    return ", ".join(f"{METRICS.get(name, name.replace('_', ' '))} {number(float(metrics[name]))}" for name in named)


Payload = Mapping[str, Any]


def _words(kind: str, payload: Payload) -> str | None:
    """What happened, or None where it is nothing to people. A kind that is not known here speaks for itself."""
    return _SENTENCES[kind](payload) if kind in _SENTENCES else kind


def _proposed(payload: Payload) -> str:
    numbers = ", ".join(str(number) for number in payload.get("trials", []))
    return f"{payload.get('strategy')} proposes trial {numbers}" if numbers else "nothing more to propose"


def _progress(payload: Payload) -> str:
    figures = metric_words(payload.get("metrics", {}))
    samples = count(float(payload.get("samples", 0)))
    return f"iteration {payload.get('iteration')}, {samples} samples{', ' if figures else ''}{figures}"


def _amended(payload: Payload) -> str:
    changes: Mapping[str, Any] = payload.get("changes", {})
    words = [f"{name} {value_of(each.get('from'))} -> {value_of(each.get('to'))}" for name, each in changes.items()]
    return f"changed: {', '.join(words)}"


def _released(payload: Payload) -> str:
    reason = payload.get("reason")
    return f"{payload.get('state')}{f': {reason}' if reason else ''}"


def _ended(how: str) -> Callable[[Payload], str]:
    return lambda payload: f"attempt {payload.get('attempt')} {how}: {first_line(str(payload.get('reason', '')), 100)}"


def _noted(kind: str) -> Callable[[Payload], str]:
    return lambda payload: f"{kind}: {first_line(str(payload.get('reason') or payload.get('message') or ''), 100)}"


def _finished(payload: Mapping[str, Any]) -> str:
    cost = f"{count(float(payload.get('samples') or 0))} samples, {duration(float(payload.get('seconds') or 0))}"
    value = payload.get("value")
    words = f"{payload.get('state')}{'' if value is None else f', value {number(value)}'} ({cost})"
    message = first_line(str(payload.get("message") or ""), 100)
    return f"{words}: {message}" if message else words


_SENTENCES: Mapping[str, Callable[[Payload], str | None]] = {
    "created": lambda _: "created",
    "asked": lambda payload: f"asked to {payload.get('wanted')}",
    "extended": lambda _: "budget raised",
    "amended": _amended,
    "driven": lambda payload: f"taken up by process {payload.get('pid')} on {payload.get('host')}",
    "released": _released,
    "proposed": _proposed,
    "started": lambda payload: f"starts (attempt {payload.get('attempt')}, {payload.get('worker')})",
    "began": lambda _: None,  # `started` has said it
    "progress": _progress,
    "lost": _ended("lost"),
    "failed": _ended("failed"),
    "preempted": _ended("stopped at a checkpoint"),
    "finished": _finished,
    "artifacts_placed": lambda payload: f"artifacts are at {payload.get('url')}",
    "warning": _noted("warning"),
    "refused": _noted("refused"),
}
