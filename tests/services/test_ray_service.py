"""How the local Ray is started; what runs on it is tested where it runs."""

import ray

from services import ray_service


def test_a_local_ray_does_not_join_a_cluster_that_somebody_started_on_this_machine(monkeypatch):
    asked = {}
    monkeypatch.setattr(ray, "init", lambda **settings: asked.update(settings))
    ray_service.start_ray({"default": 2, "wide": 4})
    # `ray start` leaves its address in /tmp/ray, where `ray.init()` without one would find and join it.
    assert asked["address"] == "local"
    assert asked["num_cpus"] == 6
    assert asked["resources"] == {"pool:wide": 4.0}
