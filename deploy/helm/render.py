"""Renders the chart with Helm's own library, for machines without `helm`: prints what `helm template NAME deploy/helm/tilecast` would.

Needs Python 3.12 and `pip install helm-sdkpy`. The library can install but not render, so it installs to a Kubernetes API that lives in
this process, accepts everything and keeps nothing.
"""

import asyncio
import json
import pathlib
import sys
import tempfile
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import helm_sdkpy

# Group and version, then the kinds that the chart has, with their names in URLs.
KINDS = {
    "v1": {"services": "Service", "secrets": "Secret", "namespaces": "Namespace"},
    "apps/v1": {"deployments": "Deployment", "statefulsets": "StatefulSet"},
    "autoscaling/v2": {"horizontalpodautoscalers": "HorizontalPodAutoscaler"},
    "networking.k8s.io/v1": {"networkpolicies": "NetworkPolicy"},
}


class Api(BaseHTTPRequestHandler):
    """As much of a Kubernetes API as an installation asks for."""

    def answer(self, code, body):
        data = json.dumps(body).encode()
        self.send_response(code)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def do_GET(self):
        path = self.path.split("?")[0].strip("/")
        version = path.removeprefix("apis/").removeprefix("api/")
        if path == "version":
            self.answer(200, {"major": "1", "minor": "33", "gitVersion": "v1.33.0"})
        elif path == "api":
            self.answer(200, {"kind": "APIVersions", "versions": ["v1"]})
        elif path == "apis":
            groups = []
            for name in KINDS:
                if "/" in name:
                    one = {"groupVersion": name, "version": name.split("/")[1]}
                    groups.append({"name": name.split("/")[0], "versions": [one], "preferredVersion": one})
            self.answer(200, {"kind": "APIGroupList", "apiVersion": "v1", "groups": groups})
        elif version in KINDS:
            resources = [
                {"name": name, "singularName": kind.lower(), "kind": kind, "namespaced": name != "namespaces",
                 "verbs": ["create", "get", "list", "patch", "update", "delete"]}
                for name, kind in KINDS[version].items()
            ]
            self.answer(200, {"kind": "APIResourceList", "apiVersion": "v1", "groupVersion": version,
                              "resources": resources})
        elif path.endswith("/secrets"):
            self.answer(200, {"kind": "SecretList", "apiVersion": "v1", "metadata": {}, "items": []})
        else:
            self.answer(404, {"kind": "Status", "apiVersion": "v1", "status": "Failure", "reason": "NotFound",
                              "code": 404, "message": "not found"})

    def take(self):
        # As it came: Helm's own records are in protobuf.
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(201)
        self.send_header("Content-Type", self.headers["Content-Type"])
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_POST = do_PUT = do_PATCH = take

    def log_message(self, *_):
        pass


async def render(port, release, chart):
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as kubeconfig:
        context = {"name": "c", "context": {"cluster": "c", "user": "c"}}
        cluster = {"name": "c", "cluster": {"server": f"http://127.0.0.1:{port}"}}
        json.dump({"apiVersion": "v1", "kind": "Config", "current-context": "c", "clusters": [cluster],
                   "contexts": [context], "users": [{"name": "c", "user": {}}]}, kubeconfig)
        kubeconfig.flush()
        with helm_sdkpy.Configuration(namespace="default", kubeconfig=kubeconfig.name) as configuration:
            await helm_sdkpy.Lint(configuration).run(chart)
            result = await helm_sdkpy.Install(configuration).run(release, chart, wait=False)
            return result


def main():
    chart = pathlib.Path(__file__).parent / "tilecast"
    server = ThreadingHTTPServer(("127.0.0.1", 0), Api)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    result = asyncio.run(render(server.server_port, sys.argv[1] if len(sys.argv) > 1 else "render", str(chart)))
    print(result["manifest"].strip())


if __name__ == "__main__":
    main()
