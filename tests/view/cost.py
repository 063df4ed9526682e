#!/usr/bin/env python3
"""What looking on costs: the same render again and again, by turns with nobody, with an open page, and with readers that stall.

Counts the render's own process, not who looks on: its processor time in all, which is what looking on may cost but drifts with
the machine; what of it is not the tracing threads', which drifts hardly at all; and its memory. `just cost` runs it, and the table of
docs/live.md is what it prints. Needs Linux.
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
    """MiB that are resident."""
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))


def processor(pid):
    """Seconds of the whole process, threads that have ended included, and of its tracing threads."""
    def seconds(path):
        user, system = pathlib.Path(path).read_text().rsplit(")", 1)[1].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    tasks = pathlib.Path(f"/proc/{pid}/task").iterdir()
    tracing = [task for task in tasks if (task / "comm").read_text().startswith("trace-")]
    return seconds(f"/proc/{pid}/stat"), sum(seconds(task / "stat") for task in tracing)


def run(arguments, kind):
    """One render: seconds in all, the part that is not tracing, memory early and at the end, digest, what was read."""
    folder = tempfile.mkdtemp()
    command = [arguments.tilecast, "render", str(SCENE), "--json", "--no-film", "-o", f"{folder}/out.exr"]
    command += ["--size", arguments.size, "--spp", str(arguments.spp), "--view"]
    held, page, sizes, spent, digest = [], None, [], None, None
    if kind == "a tev that stalls":
        held.append(stalled_tev())
        command += ["--tev", f"127.0.0.1:{held[0].getsockname()[1]}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == "viewing":
            port = int(event["url"].rstrip("/").rsplit(":", 1)[1])
            if kind == "an open page":
                page = Page(port)
        elif event["event"] == "progress":
            if kind == "pages that stall" and not held:
                held = stalled_browser(port)
            sizes.append(memory(process.pid))
            spent = processor(process.pid)
        elif event["event"] == "finished":
            digest = event["digest"]
    _, status, usage = os.wait4(process.pid, 0)
    assert status == 0 and digest and spent, f"{command} ended with {status}; it must take some seconds"
    shutil.rmtree(folder)
    [one.close() for one in held]
    return {
        "all": usage.ru_utime + usage.ru_stime, "besides": (spent[0] - spent[1]) / spent[1],
        "early": sizes[len(sizes) // 4], "late": sizes[-1], "digest": digest,
        "read": (page.states, page.bytes) if page else None,
    }


def mean(values):
    """With its 95 % interval, in per cent."""
    error = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return f"{100 * statistics.mean(values):.2f} ± {196 * error:.2f} %"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tilecast", default=str(ROOT / "target/release/tilecast"))
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--spp", type=int, default=512)
    parser.add_argument("--size", default="512x512")
    arguments = parser.parse_args()
    kinds = ["nobody", "an open page", "pages that stall", "a tev that stalls"]
    seen = {kind: [] for kind in kinds}
    for i in range(arguments.pairs):
        # Another order every time, so that what drifts meets all of them alike.
        for kind in kinds[i % len(kinds):] + kinds[:i % len(kinds)]:
            seen[kind].append(run(arguments, kind))
        print(f"{i + 1} of {arguments.pairs}", file=sys.stderr)
    assert len({one["digest"] for all in seen.values() for one in all}) == 1, "the image must not depend on who looks"
    print("| looks on | processor time in all | besides tracing | memory, early and at the end |\n|---|---|---|---|")
    for kind, runs in seen.items():
        of = lambda key, runs=runs: [one[key] for one in runs]
        pairs = list(zip(runs, seen["nobody"]))
        size = f"{statistics.median(of('early')):.0f} and {statistics.median(of('late')):.0f} MiB"
        if kind == "nobody":
            print(f"| {kind} | {statistics.median(of('all')):.1f} s | {mean(of('besides'))} | {size} |")
        else:
            whole = mean([math.log(ours["all"] / nobody["all"]) for ours, nobody in pairs])
            more = mean([ours["besides"] - nobody["besides"] for ours, nobody in pairs])
            print(f"| {kind} | {whole} more | {more} more | {size} |")
    states, read = (statistics.median(x) for x in zip(*[one["read"] for one in seen["an open page"]]))
    print(f"\n{arguments.pairs} runs each of {arguments.size} pixels, {arguments.spp} spp; the page read {states:.0f} states and {read / 1e6:.1f} MB of tiles a run.")


main()
