"""Is a scene's image the same wherever it stands?

Writes copies of a scene scaled, moved by many times its size, and turned, with every digit that this takes; renders each with a
seed of its own, and tests it against the original with `tilecast compare` (z-test over pixels, bias of the mean). Prints a line for
each; ends with an error if a test fails.

    python3 bench/placement.py SCENE.xml --spp 256 --size 48x48 --tilecast target/release/tilecast
"""

import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml

import numpy as np


def inlined(path, folder=None):
    """The scene with its includes put in."""
    folder = folder or path.parent
    root = xml.parse(path).getroot()
    for parent in list(root.iter()):
        for at, child in reversed(list(enumerate(parent))):
            if child.tag == "include":
                parent.remove(child)
                for part in reversed(list(inlined(folder / child.get("filename"), folder))):
                    parent.insert(at, part)
    return root


def place(root, scale, turn, move):
    """Every shape, the sensor and what is measured in units of the scene, by x -> scale * turn * x + move."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * turn
    matrix[:3, 3] = move
    digits = " ".join(repr(float(x)) for x in matrix.ravel())
    for node in [n for n in root.iter() if n.tag in ("shape", "sensor")]:
        to_world = node.find("transform[@name='to_world']")
        if to_world is None:
            to_world = xml.SubElement(node, "transform", name="to_world")
        xml.SubElement(to_world, "matrix", value=digits)
        if node.tag == "sensor":
            # Its position is scaled, its axes are not.
            to_world.insert(0, xml.Element("scale", value=repr(1 / scale)))
            for name, default in (("near_clip", 1e-2), ("far_clip", 1e4)):
                clip = node.find(f"float[@name='{name}']")
                if clip is None:
                    clip = xml.SubElement(node, "float", name=name, value=str(default))
                clip.set("value", repr(float(clip.get("value")) * scale))
    for node in [n for n in root.iter("bsdf") if n.get("type") == "bumpmap"]:
        height = node.find("float[@name='scale']")
        if height is None:
            height = xml.SubElement(node, "float", name="scale", value="1")
        height.set("value", repr(float(height.get("value")) * scale))
    lights = [n.get("type") for n in root.iter("emitter") if n.get("type") != "area"]
    if lights:
        sys.exit(f"this script moves area lights only, the scene has {lights}")
    return root


def turn_about(axis, angle):
    """The rotation matrix (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("--tilecast", default="target/release/tilecast")
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--size", default="48x48")
    parser.add_argument("--extent", type=float, default=10.0, help="about the scene's size")
    arguments = parser.parse_args()
    turn = turn_about([0.48, 0.6, 0.64], 1.1)
    straight = np.eye(3)
    far = np.array([0.6, -0.48, 0.64]) * arguments.extent
    places = [("original", 1.0, straight, 0 * far)]
    places += [(f"scaled by {s:g}", s, straight, 0 * far) for s in (1e-6, 1e-3, 1e3, 1e6)]
    places += [(f"moved by {s:g} sizes", 1.0, straight, s * far) for s in (1e3, 1e5, 1e7)]
    places += [("turned", 1.0, turn, 0 * far), ("scaled by 1e-3, turned, moved by 1e6 sizes", 1e-3, turn, 1e3 * far)]
    failed = 0
    with tempfile.TemporaryDirectory() as temporary:
        # A scene uses only files of its own folder.
        folder = pathlib.Path(temporary) / "scene"
        shutil.copytree(arguments.scene.parent, folder)
        for seed, (name, scale, rotation, move) in enumerate(places):
            copy, image = folder / f"placed-{seed}.xml", folder / f"placed-{seed}.exr"
            root = place(inlined(arguments.scene.resolve()), scale, rotation, move)
            xml.ElementTree(root).write(copy)
            size = ["--spp", str(arguments.spp), "--size", arguments.size, "--seed", str(seed + 1)]
            command = [arguments.tilecast, "render", str(copy), *size, "--quiet", "-o", str(image)]
            subprocess.run(command, check=True)
            if seed == 0:
                continue
            answer = subprocess.run(
                [arguments.tilecast, "compare", str(image), str(folder / "placed-0.exr"), "--json"],
                check=True, capture_output=True, text=True,
            )
            report = json.loads(answer.stdout)
            z, biases = report["ztest"], [b["p"] for b in report["bias"]]
            passes = z["smallest_p"] > 0.01 * z["allowed_p"] and z["certain_and_different"] == 0 and min(biases) > 1e-4
            failed += not passes
            print(f"{name}: smallest p {z['smallest_p']:.2e} (allowed {z['allowed_p']:.2e}),", end=" ")
            print(f"{100 * z['within_95']:.1f} % within 95 %, bias p {min(biases):.3f}: {'passes' if passes else 'FAILS'}")
    sys.exit(f"{failed} of {len(places) - 1} fail" if failed else 0)


if __name__ == "__main__":
    main()
