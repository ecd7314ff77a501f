"""Answers are what the OpenAPI description says. The long version is `make fuzz-api`."""

from __future__ import annotations

from benchmarks import fuzz_api


def test_generated_requests_never_break_the_description(tmp_path):
    found = fuzz_api.fuzz(fuzz_api.application(tmp_path), each=8, chance=1)
    assert found.failures == {}
    assert sum(found.requests.values()) > 300
    assert len(found.requests) >= 31
    assert found.statuses[200] > 100
    assert max(found.statuses) < 500


def test_a_broken_description_is_found(tmp_path):
    """The same check fails where an answer isn't what is described."""
    from fastapi import Response

    app = fuzz_api.application(tmp_path)

    @app.get("/api/v1/odd")
    def odd() -> dict[str, int]:
        return Response('{"a": "no number"}', 418, media_type="application/json")

    assert any("/api/v1/odd" in label for label in fuzz_api.fuzz(app, each=1, chance=1).failures)
