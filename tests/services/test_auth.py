"""The token file and the limit on guessing."""

from __future__ import annotations

import stat

import pytest

from services.auth import LoginThrottle, load_or_create_token
from services.errors import BadInput


class TestToken:
    def test_it_is_made_once_for_its_owner_only(self, tmp_path):
        home = tmp_path / "home"
        made = load_or_create_token(home)
        assert made.created
        assert stat.S_IMODE(made.path.stat().st_mode) == 0o600
        assert len(made.token) >= 43
        again = load_or_create_token(home)
        assert (again.token, again.created) == (made.token, False)
        assert [path.name for path in home.iterdir()] == ["token"]

    def test_one_that_others_can_read_is_refused_with_the_command_to_run(self, tmp_path):
        path = load_or_create_token(tmp_path).path
        path.chmod(0o644)
        with pytest.raises(BadInput, match="only its owner can read it, found mode 0644; run `chmod 600 "):
            load_or_create_token(tmp_path)

    @pytest.mark.parametrize("text", ["", "short", "has a space in its middle", "éééééééééééééééééééé"])
    def test_one_that_is_no_token_is_refused(self, tmp_path, text):
        (tmp_path / "token").write_text(text, encoding="utf-8")
        (tmp_path / "token").chmod(0o600)
        with pytest.raises(BadInput, match="expected at least 16 printable ASCII characters"):
            load_or_create_token(tmp_path)

    def test_a_home_that_is_a_file_is_refused(self, tmp_path):
        (tmp_path / "home").touch()
        with pytest.raises(BadInput, match="expected to keep the access token there"):
            load_or_create_token(tmp_path / "home")


class TestThrottle:
    def test_a_few_guesses_are_free_and_then_one_a_while(self):
        now = [0.0]
        throttle = LoginThrottle(burst=3, refill_seconds=10, clock=lambda: now[0])
        for _ in range(3):
            assert throttle.wait("a") == 0
            throttle.failed("a")
        assert throttle.wait("a") == 10
        now[0] = 9.9
        assert throttle.wait("a") == pytest.approx(0.1)
        now[0] = 10.0
        assert throttle.wait("a") == 0
        throttle.failed("a")
        assert throttle.wait("a") == 10

    def test_one_address_does_not_lock_out_another(self):
        throttle = LoginThrottle(burst=1, clock=lambda: 0.0)
        throttle.failed("a")
        assert throttle.wait("a") > 0
        assert throttle.wait("b") == 0

    def test_its_memory_is_bounded(self):
        throttle = LoginThrottle(burst=1, clock=lambda: 0.0, most_addresses=2)
        for address in "abc":
            throttle.failed(address)
        assert throttle.wait("a") == 0
        assert throttle.wait("c") > 0
