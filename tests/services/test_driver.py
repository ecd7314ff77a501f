import dataclasses
import os
import subprocess
import sys
import time

from services.driver import lives, this_process


def test_this_process_lives():
    assert lives(this_process()) is True


def test_two_drives_of_one_process_are_two_drivers():
    assert this_process().id != this_process().id


def test_a_process_that_ended_is_dead_even_before_it_is_reaped():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    driver = dataclasses.replace(this_process(), pid=child.pid, started="")
    assert lives(driver) is True
    child.kill()
    deadline = time.monotonic() + 20
    while lives(driver) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert lives(driver) is False  # a zombie: nobody has waited for it yet
    child.communicate()
    assert lives(driver) is False


def test_a_reused_process_id_is_noticed_by_its_start_time():
    other = dataclasses.replace(this_process(), started="1")
    assert other.pid == os.getpid()
    assert lives(other) is False


def test_a_driver_of_another_host_cannot_be_seen():
    assert lives(dataclasses.replace(this_process(), host="elsewhere.invalid")) is None
