"""How halma is deployed, checked as far as it goes without a Docker daemon or a cluster."""

import http.server
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
FILE = (DOCKER / "Dockerfile").read_text(encoding="utf-8")
TARGETS = {"head", "worker", "dashboard"}


def stages():
    """Lines of each stage of the Dockerfile by name, with those of the stages that it is built from."""
    found, name = {}, None
    for line in FILE.splitlines():
        begin = re.match(r"FROM (\S+) AS (\S+)", line)
        if begin:
            name = begin[2]
            found[name] = list(found.get(begin[1], []))
        elif name:
            found[name].append(line)
    return found


def compose():
    return yaml.safe_load((DOCKER / "compose.yaml").read_text(encoding="utf-8"))


def kuberay():
    return list(yaml.safe_load_all((DOCKER / "kuberay.yaml").read_text(encoding="utf-8")))


def test_the_linter_of_dockerfiles_finds_nothing():
    linter = Path(sys.executable).with_name("hadolint")
    done = subprocess.run([linter, "--no-color", DOCKER / "Dockerfile"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_each_image_runs_as_somebody_else_than_root_and_has_a_health_check(target):
    lines = stages()[target]
    assert [line for line in lines if line.startswith("USER")][-1] == "USER 10001"
    assert any(line.startswith("HEALTHCHECK") and f'"{target}"' in line for line in lines)
    assert any(line.startswith("CMD") for line in lines)


def test_the_dockerfile_copies_what_there_is_and_the_context_does_not_leave_out():
    left_out = {line.strip("/") for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if line}
    for line in FILE.splitlines():
        if line.startswith("COPY") and "--from" not in line:
            for source in line.split()[1:-1]:
                assert (ROOT / source).exists(), line
                assert source.partition("/")[0] not in left_out, line


def test_the_services_of_compose_name_targets_conditions_and_volumes_that_exist():
    given = compose()
    services = given["services"]
    for name, service in services.items():
        assert ("image" in service) != ("build" in service), name
        if "build" in service:
            assert service["build"]["target"] in TARGETS
            assert (DOCKER / service["build"]["context"] / service["build"]["dockerfile"]).exists()
        else:
            assert re.fullmatch(r"[a-z/]+:[\w.-]+", service["image"]), f"{name}: expected a pinned image"
        for other, condition in service.get("depends_on", {}).items():
            needed = services[other]
            if condition["condition"] == "service_healthy":
                assert "healthcheck" in needed or needed["build"]["target"] in TARGETS
        for volume in service.get("volumes", []):
            assert volume.partition(":")[0] in given["volumes"]
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:"), f"{name}: only this machine, until there is TLS"


def test_every_secret_of_compose_is_asked_for_and_none_is_written_down():
    text = (DOCKER / "compose.yaml").read_text(encoding="utf-8")
    asked = set(re.findall(r"\$\{(\w+)", text))
    example = dict(line.split("=", 1) for line in (DOCKER / "example.env").read_text().splitlines() if "=" in line)
    assert asked == set(example)
    assert not any(example.values())
    for name in asked:
        assert f"${{{name}:?" in text, f"{name}: expected that compose refuses to start without it"


def test_everybody_who_works_on_the_record_gets_the_same_places():
    services = compose()["services"]
    record = {"HALMA_DB", "HALMA_ARTIFACTS", "AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "RAY_AUTH_TOKEN"}
    for name in ("head", "worker", "dashboard"):
        assert record <= set(services[name]["environment"]), name
        for key in record:
            assert services[name]["environment"][key] == services["head"]["environment"][key]


def test_the_manifest_for_kuberay_has_what_the_operator_needs():
    cluster, deployment, service = kuberay()
    assert (cluster["apiVersion"], cluster["kind"]) == ("ray.io/v1", "RayCluster")
    head, (group,) = cluster["spec"]["headGroupSpec"], cluster["spec"]["workerGroupSpecs"]
    assert {"groupName", "replicas", "minReplicas", "maxReplicas", "rayStartParams", "template"} <= set(group)
    assert group["minReplicas"] <= group["replicas"] <= group["maxReplicas"]
    # The operator passes these on as text; a number is refused.
    assert all(isinstance(value, str) for value in head["rayStartParams"].values())
    assert service["spec"]["selector"] == deployment["spec"]["template"]["metadata"]["labels"]
    assert deployment["spec"]["selector"]["matchLabels"] == service["spec"]["selector"]


@pytest.mark.parametrize("which", [0, 1, 2], ids=["head", "worker", "dashboard"])
def test_every_pod_is_not_root_limited_and_an_image_of_ours(which):
    cluster, deployment, _ = kuberay()
    templates = [
        cluster["spec"]["headGroupSpec"]["template"],
        cluster["spec"]["workerGroupSpecs"][0]["template"],
        deployment["spec"]["template"],
    ]
    pod = templates[which]["spec"]
    assert pod["securityContext"]["runAsNonRoot"]
    assert pod["securityContext"]["runAsUser"] == 10001
    (container,) = pod["containers"]
    assert container["image"].partition(":")[0].removeprefix("halma-") in TARGETS
    assert "memory" in container["resources"]["limits"]
    assert container["envFrom"] == [{"secretRef": {"name": "halma"}}]
    mounted = {mount["name"] for mount in container.get("volumeMounts", [])}
    assert mounted == {volume["name"] for volume in pod.get("volumes", [])}


class Ready(http.server.BaseHTTPRequestHandler):
    status = 200

    def do_GET(self):
        self.send_response(self.status)
        self.end_headers()

    def log_message(self, *_):
        pass


def test_the_health_check_tells_a_service_that_is_ready_from_one_that_is_not():
    import importlib.util

    spec = importlib.util.spec_from_file_location("healthy", DOCKER / "healthy.py")
    healthy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(healthy)
    server = http.server.HTTPServer(("127.0.0.1", 0), Ready)
    address = f"127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        assert healthy.is_ready(f"http://{address}/readyz")
        assert healthy.answers(address)
        Ready.status = 503
        assert not healthy.is_ready(f"http://{address}/readyz")
    finally:
        server.shutdown()
        server.server_close()
        Ready.status = 200
    assert not healthy.answers(address)
    assert not healthy.runs("no-such-program")
