"""Makes the meshes, textures and the environment map in scenes/shared, which the scenes beside this file use.

    make_assets.py

All of them are computed, none is anybody's work: CC0. Needs numpy and Mitsuba 3 (pip install mitsuba), which writes the
images. The files are checked in; run it again only to change them, and then make_references.py.
"""
import pathlib
import struct
import sys
import zlib

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
SHARED = HERE / 'scenes' / 'shared'
sys.path.insert(0, str(HERE.parents[1] / 'bench'))
import mitsuba_oracle as oracle  # noqa: E402

RING, TUBE = 20, 12


def torus():
    """A coarse torus around the y axis, radii 0.7 and 0.35: positions, normals, uv ((RING+1)·(TUBE+1) rows) and quads."""
    u, v = np.meshgrid(np.arange(RING + 1) / RING, np.arange(TUBE + 1) / TUBE, indexing='ij')
    around, across = 2 * np.pi * u.ravel(), 2 * np.pi * v.ravel()
    normals = np.stack([np.cos(around) * np.cos(across), np.sin(across), np.sin(around) * np.cos(across)], axis=-1)
    centres = 0.7 * np.stack([np.cos(around), np.zeros_like(around), np.sin(around)], axis=-1)
    corner = lambda i, j: i * (TUBE + 1) + j  # noqa: E731
    quads = [[corner(i, j), corner(i, j + 1), corner(i + 1, j + 1), corner(i + 1, j)]
             for i in range(RING) for j in range(TUBE)]
    return centres + 0.35 * normals, normals, np.stack([u.ravel(), v.ravel()], axis=-1), np.array(quads)


def triangles(quads):
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def write_obj(path, positions, quads, normals=None, uv=None):
    """Quads, so that a reader has to cut them; every corner v/vt/vn if there are normals."""
    lines = ['v {:.5f} {:.5f} {:.5f}'.format(*p) for p in positions]
    corner = '{0}'
    if normals is not None:
        lines += ['vt {:.5f} {:.5f}'.format(*t) for t in uv]
        lines += ['vn {:.5f} {:.5f} {:.5f}'.format(*n) for n in normals]
        corner = '{0}/{0}/{0}'
    lines += ['f ' + ' '.join(corner.format(i + 1) for i in quad) for quad in quads]
    path.write_text('\n'.join(lines) + '\n')


def closed(positions, quads):
    """The same surface with each point once, so that computed normals are smooth across the seams."""
    points, index = np.unique(np.round(positions, 5), axis=0, return_inverse=True)
    return points, index.ravel()[quads]


def ply_header(encoding, vertex, faces):
    count, names = vertex
    properties = ''.join(f'property float {name}\n' for name in names)
    return (f'ply\nformat {encoding} 1.0\nelement vertex {count}\n{properties}element face {faces}\n'
            'property list uchar int vertex_indices\nend_header\n')


def write_plys():
    positions, normals, uv, quads = torus()
    faces = triangles(quads)
    rows = np.concatenate([positions, normals, uv], axis=-1)
    text = ply_header('ascii', (len(rows), ['x', 'y', 'z', 'nx', 'ny', 'nz', 'u', 'v']), len(faces))
    text += ''.join(' '.join(f'{x:.5f}' for x in row) + '\n' for row in rows)
    text += ''.join('3 {} {} {}\n'.format(*face) for face in faces)
    (SHARED / 'torus-text.ply').write_text(text)

    # Without normals, closed, and with a colour at every vertex.
    points, quads = closed(positions, quads)
    faces = triangles(quads)
    colours = np.clip(0.5 + 0.45 * np.sin(points @ np.array([[3, 0, 2], [0, 5, 1], [2, 1, -3]])), 0, 1)
    body = np.concatenate([points, colours], axis=-1).astype('<f4').tobytes()
    body += b''.join(struct.pack('<Biii', 3, *face) for face in faces)
    header = ply_header('binary_little_endian', (len(points), ['x', 'y', 'z', 'r', 'g', 'b']), len(faces))
    (SHARED / 'torus-colours.ply').write_bytes(header.encode() + body)
    # The other byte order, and nothing but positions.
    body = points.astype('>f4').tobytes() + b''.join(struct.pack('>Biii', 3, *face) for face in faces)
    header = ply_header('binary_big_endian', (len(points), ['x', 'y', 'z']), len(faces))
    (SHARED / 'torus-big-endian.ply').write_bytes(header.encode() + body)


def serialized_mesh(name, positions, normals, uv, faces):
    """One mesh of Mitsuba's format, version 4: flags 1 (normals), 2 (uv), 0x1000 (single precision)."""
    body = struct.pack('<I', 0x1000 | (1 if normals is not None else 0) | 2) + name.encode() + b'\0'
    body += struct.pack('<QQ', len(positions), len(faces)) + positions.astype('<f4').tobytes()
    body += normals.astype('<f4').tobytes() if normals is not None else b''
    body += uv.astype('<f4').tobytes() + faces.astype('<u4').tobytes()
    return struct.pack('<HH', 0x041C, 4) + zlib.compress(body, 9)


def write_serialized():
    positions, normals, uv, quads = torus()
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.8
    meshes = [serialized_mesh('square', square, None, (square[:, :2] + 1) / 2, np.array([[0, 1, 2], [0, 2, 3]])),
              serialized_mesh('torus', positions, normals, uv, triangles(quads))]
    offsets = np.cumsum([0] + [len(mesh) for mesh in meshes[:-1]])
    dictionary = struct.pack(f'<{len(meshes)}QI', *offsets, len(meshes))
    (SHARED / 'meshes.serialized').write_bytes(b''.join(meshes) + dictionary)


def write_image(mitsuba, name, values, quality=-1):
    """float32 values for EXR and HDR, 8-bit ones otherwise; a third axis of three is RGB."""
    mitsuba.Bitmap(values).write(str(SHARED / name), quality=quality)


def write_textures(mitsuba):
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16, (np.arange(12) + 0.5) / 12)
    waves = np.stack([0.5 + 0.4 * np.sin(6 * x + 2 * y), 0.5 + 0.4 * np.cos(5 * y), 0.3 + 0.5 * x * y], axis=-1)
    write_image(mitsuba, 'colours.png', np.round(255 * waves).astype(np.uint8))
    write_image(mitsuba, 'grey.png', np.round(255 * (0.15 + 0.7 * x * (1 - y)))[..., None].astype(np.uint8))
    linear = np.stack([0.1 + 0.8 * x, 0.9 - 0.7 * y, 0.2 + 0.6 * (x - y) ** 2], axis=-1)
    write_image(mitsuba, 'colours.exr', linear.astype(np.float32))
    write_image(mitsuba, 'lamp.hdr', (4 * waves).astype(np.float32))
    # Flat 8x8 blocks: JPEG's decoders differ in how they round cosines and spread chroma, which flat blocks have not.
    blocks = np.random.default_rng(5).integers(40, 220, (4, 4, 3)).repeat(8, axis=0).repeat(8, axis=1)
    write_image(mitsuba, 'blocks.jpg', blocks.astype(np.uint8), quality=100)
    # Height of gentle hills, and the same hills as tangent-space normals.
    x, y = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(32) + 0.5) / 32)
    height = 0.5 + 0.25 * np.sin(4 * np.pi * x) * np.sin(4 * np.pi * y)
    write_image(mitsuba, 'height.exr', height[..., None].astype(np.float32))
    tilt = np.stack([0.4 * np.cos(4 * np.pi * x), 0.4 * np.cos(4 * np.pi * y), np.ones_like(x)], axis=-1)
    tilt /= np.linalg.norm(tilt, axis=-1, keepdims=True)
    write_image(mitsuba, 'normals.exr', (0.5 + 0.5 * tilt).astype(np.float32))


def write_environment(mitsuba):
    """A sky with one broad bright spot and a warm ground, 32x16."""
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, np.arange(16) / 15)
    azimuth, polar = 2 * np.pi * u, np.pi * v
    direction = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], axis=-1)
    spot = np.exp(6 * (direction @ np.array([0.48, 0.64, 0.6]) - 1))[..., None] * np.array([4, 3.5, 2.5])
    side = np.where(direction[..., :1] > 0, [0.35, 0.2, 0.2], [0.15, 0.25, 0.3])
    sky = np.clip(direction[..., 1:2], 0, 1) * np.array([0.2, 0.3, 0.6])
    write_image(mitsuba, 'sky.exr', (spot + side + sky).astype(np.float32))


def main():
    mitsuba = oracle.load()
    SHARED.mkdir(parents=True, exist_ok=True)
    positions, normals, uv, quads = torus()
    write_obj(SHARED / 'torus.obj', positions, quads, normals, uv)
    write_obj(SHARED / 'torus-bare.obj', *closed(positions, quads))
    write_plys()
    write_serialized()
    write_textures(mitsuba)
    write_environment(mitsuba)


if __name__ == '__main__':
    main()
