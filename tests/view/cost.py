#!/usr/bin/env python3
"""What looking on costs: the same render again and again, by turns with nobody, with an open page, and with readers that stall.

Counts the user time and the instructions of the render's own process, not of who looks on, and its memory. `just cost` runs it;
the table of docs/live.md is what it prints. Needs Linux; counts instructions where there is a `perf` that may.
"""

import argparse
import http.client
import json
import math
import os
import pathlib
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENE = ROOT / "scenes/cornell-box/scene.xml"
# A page asks for tiles this long after it has the last ones.
PICTURE_PAUSE_S = 0.5
# Readers that stall, at a time: as many pages as anyone leaves open.
STALLED = 20


class Page(threading.Thread):
    """Reads states and tiles as the page does, and forgets them."""

    def __init__(self, port):
        super().__init__(daemon=True)
        self.port, self.version, self.states, self.bytes, self.latest = port, 0, 0, 0, None
        self.start()

    def ask(self, path):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.request("GET", path, headers={"x-tilecast": "1"})
        return connection.getresponse()

    def run(self):
        threading.Thread(target=self.tiles, daemon=True).start()
        try:
            feed = self.ask("/api/live")
            while line := feed.readline():
                if line.startswith(b"data: "):
                    self.latest, self.states = json.loads(line[6:]), self.states + 1
        except (OSError, http.client.HTTPException):
            pass

    def tiles(self):
        try:
            while True:
                time.sleep(PICTURE_PAUSE_S)
                state = self.latest
                if state and state["jobs"] and (state["jobs"][0]["version"] or 0) > self.version:
                    path = f"/api/jobs/{state['jobs'][0]['id']}/tiles/{state['instance']}/{self.version}"
                    body = self.ask(path).read()
                    self.version = int.from_bytes(body[8:16], "little")
                    self.bytes += len(body)
        except (OSError, http.client.HTTPException):
            pass


def stalled_browser(port):
    """Connections that ask for states and tiles, and never read an answer."""
    feed = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    feed.request("GET", "/api/live")
    instance = json.loads(next(line for line in feed.getresponse() if line.startswith(b"data: "))[6:])["instance"]
    held = [feed]
    for i in range(STALLED):
        peer = socket.create_connection(("127.0.0.1", port))
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        path = "/api/live" if i % 2 else f"/api/jobs/1/tiles/{instance}/0"
        peer.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nx-tilecast: 1\r\n\r\n".encode())
        held.append(peer)
    return held


def stalled_tev():
    """A viewer that lets who connects wait for ever."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    return listener


def memory(pid):
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))


def run(arguments, kind):
    """One render: user seconds, instructions, memory early and at the end (MiB), digest, what was read."""
    folder = tempfile.mkdtemp()
    command = [arguments.tilecast, "render", str(SCENE), "--json", "--no-film", "-o", f"{folder}/out.exr"]
    command += ["--size", arguments.size, "--spp", str(arguments.spp), "--view"]
    held = []
    if kind == "a tev that stalls":
        held.append(stalled_tev())
        command += ["--tev", f"127.0.0.1:{held[0].getsockname()[1]}"]
    if arguments.perf:
        command = ["perf", "stat", "-x,", "-e", "instructions:u", "-o", f"{folder}/perf", "--"] + command
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    page, sizes, digest = None, [], None
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == "viewing":
            port = int(event["url"].rstrip("/").rsplit(":", 1)[1])
            tracer = child(process.pid) if arguments.perf else process.pid
            if kind == "an open page":
                page = Page(port)
        elif event["event"] == "progress":
            if kind == "pages that stall" and not held:
                held = stalled_browser(port)
            sizes.append(memory(tracer))
        elif event["event"] == "finished":
            digest = event["digest"]
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0 and digest, f"{command} ended with {status}"
    instructions = None
    if arguments.perf:
        with open(f"{folder}/perf") as perf:
            instructions = float(next(line for line in perf if "instructions" in line).split(",")[0])
    shutil.rmtree(folder)
    [one.close() for one in held]
    early = sizes[len(sizes) // 4] if sizes else math.nan
    return {
        "user": usage.ru_utime, "instructions": instructions, "early": early, "late": sizes[-1] if sizes else math.nan,
        "digest": digest, "read": (page.states, page.bytes) if page else None,
    }


def child(pid):
    """The render below `perf`."""
    for _ in range(100):
        below = pathlib.Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        if below:
            return int(below[0])
        time.sleep(0.05)
    sys.exit("perf has started nothing")


def ratio(ours, theirs):
    """The mean ratio of pairs and its 95 % interval, in per cent more."""
    logs = [math.log(a / b) for a, b in zip(ours, theirs)]
    mean, error = statistics.mean(logs), statistics.stdev(logs) / math.sqrt(len(logs)) if len(logs) > 1 else math.nan
    return f"{100 * math.expm1(mean):+.2f} ± {196 * error:.2f} %"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tilecast", default=str(ROOT / "target/release/tilecast"))
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--spp", type=int, default=512)
    parser.add_argument("--size", default="512x512")
    arguments = parser.parse_args()
    probe = ["perf", "stat", "-e", "instructions:u", "true"]
    arguments.perf = bool(shutil.which("perf")) and subprocess.run(probe, capture_output=True).returncode == 0
    kinds = ["nobody", "an open page", "pages that stall", "a tev that stalls"]
    seen = {kind: [] for kind in kinds}
    for i in range(arguments.pairs):
        # Another order every time, so that what drifts meets all of them alike.
        for kind in kinds[i % len(kinds):] + kinds[:i % len(kinds)]:
            seen[kind].append(run(arguments, kind))
        print(f"{i + 1} of {arguments.pairs}", file=sys.stderr)
    assert len({one["digest"] for all in seen.values() for one in all}) == 1, "the image must not depend on who looks"
    print("| looks on | user time | instructions | memory, early and at the end |\n|---|---|---|---|")
    for kind, runs in seen.items():
        of = lambda key, runs=runs: [one[key] for one in runs]
        base = lambda key: [one[key] for one in seen["nobody"]]
        size = f"{statistics.median(of('early')):.0f} and {statistics.median(of('late')):.0f} MiB"
        if kind == "nobody":
            counted = f"{statistics.median(of('instructions')) / 1e9:.1f} G" if arguments.perf else "–"
            print(f"| {kind} | {statistics.median(of('user')):.2f} s | {counted} | {size} |")
        else:
            counted = ratio(of("instructions"), base("instructions")) if arguments.perf else "–"
            print(f"| {kind} | {ratio(of('user'), base('user'))} | {counted} | {size} |")
    states, read = (statistics.median(x) for x in zip(*[one["read"] for one in seen["an open page"]]))
    print(f"\n{arguments.pairs} runs each of {arguments.size} pixels, {arguments.spp} spp; the page read {states:.0f} states and {read / 1e6:.1f} MB of tiles a run.")


main()
