"""Hosts that come and go, and where a worker fits."""

import socket

import pytest

from services.dispatch.hosts import Hosts, best_fit, cores_by_pool, take_room


def node(name, *, alive=True, port=1, **resources):
    return {
        "NodeID": name,
        "Alive": alive,
        "NodeManagerAddress": "127.0.0.1",
        "NodeManagerPort": port,
        "Resources": resources,
    }


def hosts_of(*nodes, caps=None):
    hosts = Hosts(lambda: nodes, caps)
    hosts.refresh()
    return hosts


def test_what_a_host_gives_to_named_pools_is_missing_from_the_default_one():
    assert cores_by_pool({"CPU": 8.0, "pool:gpu": 2.0, "memory": 1e9}) == {"gpu": 2.0, "default": 6.0}
    assert cores_by_pool({"CPU": 2.0, "pool:gpu": 2.0}) == {"gpu": 2.0}
    assert cores_by_pool({"memory": 1e9}) == {}


def test_pools_are_the_sum_of_the_hosts_that_live():
    hosts = hosts_of(node("a", CPU=4), node("b", CPU=2, **{"pool:gpu": 1}), node("c", alive=False, CPU=64))
    assert hosts.pools() == {"default": 5, "gpu": 1}
    assert hosts.rooms("default", {"a": 1.5}) == {"a": 2.5, "b": 1.0}
    assert hosts.rooms("gpu", {}) == {"b": 1.0}


def test_pools_follow_hosts_that_join_and_leave():
    cluster = [node("a", CPU=2)]
    hosts = Hosts(lambda: cluster, None)
    hosts.refresh()
    cluster.append(node("b", CPU=8))
    hosts.refresh()
    assert hosts.rooms("default", {}) == {"a": 2, "b": 8}
    del cluster[0]
    hosts.refresh()
    assert hosts.rooms("default", {"a": 2}) == {"b": 8}


def test_a_cap_holds_over_all_hosts_and_hides_other_pools():
    hosts = hosts_of(node("a", CPU=4), node("b", CPU=4, **{"pool:gpu": 1}), caps={"default": 5})
    assert hosts.pools() == {"default": 5}
    assert sum(hosts.rooms("default", {"a": 1}).values()) == 4
    assert hosts.rooms("default", {"a": 4, "b": 1}) == {}
    assert hosts.rooms("gpu", {}) == {}


def test_cores_on_two_hosts_are_no_room_for_one_wide_trial():
    rooms = {"a": 2.0, "b": 2.0}
    assert best_fit(rooms, 3) is None
    assert not take_room(rooms, 3)
    assert rooms == {"a": 2.0, "b": 2.0}


def test_a_narrow_trial_goes_where_it_leaves_room_for_a_wide_one():
    rooms = {"wide": 4.0, "narrow": 1.0}
    assert take_room(rooms, 1)
    assert take_room(rooms, 4)
    assert rooms == {"wide": 0.0, "narrow": 0.0}


@pytest.fixture
def listening():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield server


def test_nothing_is_sent_to_a_host_in_doubt_before_it_answers(listening):
    port = listening.getsockname()[1]
    hosts = hosts_of(node("head", CPU=1), node("b", CPU=4, port=port))
    listening.close()
    hosts.doubt("b")
    assert hosts.rooms("default", {}) == {"head": 1}
    hosts.refresh()
    assert hosts.rooms("default", {}) == {"head": 1}, "Ray still takes it for alive, but it does not answer"
    with socket.create_server(("127.0.0.1", port)):
        hosts.refresh()
    assert hosts.rooms("default", {}) == {"head": 1, "b": 4}
