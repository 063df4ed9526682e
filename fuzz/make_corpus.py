"""Seeds for the fuzzer, from the project's own scenes: `python fuzz/make_corpus.py TILECAST` from the root.

Files that say with a first byte what follows (harness/src) get one; film records are cut out of their checksummed frames, as the
fuzzer cannot make those.
"""
import hashlib
import pathlib
import struct
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent
SHARED = ROOT.parent / 'tests/conformance/scenes/shared'
TEXTURES = {'.png': 0, '.jpg': 1, '.exr': 2, '.hdr': 3, '.tga': 4}
SEED_BYTES_MAX = 20_000


def put(target, data):
    if len(data) <= SEED_BYTES_MAX:
        folder = ROOT / 'corpus' / target
        folder.mkdir(parents=True, exist_ok=True)
        (folder / hashlib.sha1(data).hexdigest()).write_bytes(data)


def payloads(film):
    """The records of a film file: 16 bytes of kind, then length (u32), check (16 bytes), payload."""
    at = 16
    while at < len(film):
        length, = struct.unpack_from('<I', film, at)
        yield film[at + 20:at + 20 + length]
        at += 20 + length


def films(tilecast):
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / 'out.exr'
        subprocess.run([tilecast, 'render', ROOT.parent / 'scenes/cornell-box/scene.xml', '--size', '3x2', '--spp', '8',
                        '-o', out, '--quiet'], check=True)
        film = out.with_suffix('.film').read_bytes()
    put('film', b'\0' + film)
    put('film', b'\1' + b''.join(struct.pack('<H', len(payload)) + payload for payload in payloads(film)))


def main():
    for path in sorted(ROOT.parent.glob('scenes/*/scene.xml')) + sorted(ROOT.parent.glob('tests/conformance/scenes/*.xml'))[::8]:
        put('xml', path.read_bytes())
    for path in list(ROOT.parent.glob('scenes/**/*.obj')) + list(ROOT.parent.glob('scenes/**/*.mtl')):
        put('obj', path.read_bytes())
    for path in SHARED.iterdir():
        data = path.read_bytes()
        if path.suffix in ('.obj', '.ply'):
            put(path.suffix[1:], data)
        elif path.suffix == '.serialized':
            put('serialized', b'\0' + data)
        elif path.suffix in TEXTURES:
            put('texture', bytes([TEXTURES[path.suffix]]) + data)
    films(sys.argv[1])
    # An entry of a journal: which, tile, samples, contributor, sums. And a unit, an empty message of each kind.
    put('journal', b'\1' + struct.pack('<H', 8) + bytes([0, 0, 0, 1, 1, 0, 4, 0]) + struct.pack('<H', 2) + bytes([1, 3]))
    for kind in range(16):
        put('wire', bytes([kind]))
    put('wire', bytes([2, 8, 1, 18, 8, 8, 0, 16, 0, 24, 4, 32, 4, 24, 0, 32, 4]))


if __name__ == '__main__':
    main()
