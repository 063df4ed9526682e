"""Does tilecast converge to the same image as Mitsuba 3?

    mitsuba_agreement.py SCENE.xml --renders 64 --spp 128 --tilecast target/release/tilecast

One noisy image against another proves nothing, and one very long render hides where it differs. So both renderers render
the scene N times with independent seeds. That gives every pixel a mean and an honest standard error on each side,
whatever the noise looks like, and the question becomes a two-sample (Welch) test, made three times:

  pixels   z = (mean_a - mean_b) / sqrt(s_a^2/N + s_b^2/N) for each pixel and channel; the share with |z| < 3.3.
           Mitsuba against itself (N further seeds) says what share is to be expected of a perfect match: pixels that are
           lit by rare events are not normal at this N, and fail a fair test now and then.
  blocks   the same z for means over 8x8 pixels; the share with |z| < 4. Sees small errors that cover an area.
  means    ratio of the two images' means, with its 95 % interval. Sees an error of scale too small for any pixel.

Exit status 1 if pixels fall more than 1 point below Mitsuba's own share, blocks below 99 %, or a mean differs by more
than --means (0.002); 2 on usage. Without --tilecast only Mitsuba is tested against itself.
Where tilecast's images carry Variance channels, their average is compared with the variance seen between the renders:
near 1 means that its error bars are honest (printed, not judged).

Mitsuba's renders are kept in --cache, named by the scene file's text, samples and -D; delete it when a mesh, a texture
or an included file changes.
"""
import argparse
import hashlib
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

import mitsuba_oracle as oracle

PIXEL_Z, BLOCK_Z, BLOCK = 3.3, 4.0, 8
FIRST_SEED = 1000
# Both renderers add up f32 samples or f32 film weights: differences below this share of the value are rounding.
ROUNDING = 1e-5
# A pixel that only the farthest tail of its filter lights: Mitsuba splats every sample there with a tiny weight, tilecast
# draws positions by the filter and none of N x spp samples may fall there. Its sample variance is then 0 and z says
# nothing. Differences below this share of the image's mean are not judged pixel by pixel.
FAINT = 1e-6


def z_scores(a, b):
    """Welch's z for stacks of renders (renders, ...), with a floor under the standard error: ROUNDING and FAINT."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    floor = ROUNDING * np.maximum(np.abs(mean_a), np.abs(mean_b)) + FAINT * np.abs(mean_b).mean()
    error = np.sqrt(a.var(axis=0, ddof=1) / len(a) + b.var(axis=0, ddof=1) / len(b) + floor ** 2)
    difference = mean_a - mean_b
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(difference == 0, 0.0, difference / error)


def block_means(stack):
    """Means over BLOCK x BLOCK pixels, (renders, rows, columns, 3); blocks at the far edges may be smaller."""
    _, height, width, _ = stack.shape
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    sums = np.add.reduceat(np.add.reduceat(stack, rows, axis=1), columns, axis=2)
    return sums / np.outer(np.diff(np.append(rows, height)), np.diff(np.append(columns, width)))[None, :, :, None]


def ratio_of_means(a, b):
    """Per channel: mean(a)/mean(b) and half its 95 % interval (delta method), from the means of whole renders."""
    means_a, means_b = a.mean(axis=(1, 2)), b.mean(axis=(1, 2))
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = np.where(means_b.mean(axis=0) == means_a.mean(axis=0), 1.0, means_a.mean(axis=0) / means_b.mean(axis=0))
        spread = sum(m.var(axis=0, ddof=1) / len(m) / m.mean(axis=0) ** 2 for m in (means_a, means_b))
    return ratio, 1.96 * ratio * np.sqrt(np.nan_to_num(spread))


def compare(name, a, b):
    """Print a line for the pair of stacks; return pixel share, block share, worst |ratio - 1|, widest interval."""
    pixels = float(np.mean(np.abs(z_scores(a, b)) < PIXEL_Z))
    blocks = float(np.mean(np.abs(z_scores(block_means(a), block_means(b))) < BLOCK_Z))
    ratio, interval = ratio_of_means(a, b)
    means = ' '.join(f'{channel} {r:.5f} +-{i:.5f}' for channel, r, i in zip('RGB', ratio, interval))
    print(f'{name}: pixels {100 * pixels:.2f} %, blocks {100 * blocks:.2f} %, means {means}', flush=True)
    return pixels, blocks, float(np.max(np.abs(ratio - 1))), float(np.max(interval))


def mitsuba_renders(mitsuba, options, count):
    """`count` independent renders, (count, height, width, 3), from the cache as far as it has them."""
    text = pathlib.Path(options.scene).read_bytes()
    settings = f'{options.spp} {sorted(options.define)} {mitsuba.__version__} {options.size}'
    key = hashlib.sha256(text + settings.encode()).hexdigest()[:12]
    folder = pathlib.Path(options.cache) / f'{pathlib.Path(options.scene).stem}-{key}'
    folder.mkdir(parents=True, exist_ok=True)
    scene, stack = None, []
    for k in range(count):
        path = folder / f'{k:03d}.npy'
        if not path.exists():
            if scene is None:
                scene = oracle.load_scene(mitsuba, options.scene, options.define, options.size)
            np.save(path, oracle.render(mitsuba, scene, options.spp, FIRST_SEED + k).astype(np.float32))
        stack.append(np.load(path))
    return np.stack(stack).astype(np.float64)


def tilecast_renders(mitsuba, options):
    """The renders, and the mean of the variances that the images claim for themselves (None where they claim none)."""
    stack, claimed = [], []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(options.renders):
            out = pathlib.Path(folder) / f'{k}.exr'
            spp = str(options.tilecast_spp or options.spp)
            command = [options.tilecast, 'render', options.scene, '--spp', spp, '--seed', str(k),
                       '-o', str(out), '--quiet']
            command += [word for define in options.define for word in ('-D', define)]
            command += ['--size', '{}x{}'.format(*options.size)] if options.size else []
            command += ['--offsets', options.offsets] if options.offsets else []
            subprocess.run(command, check=True)
            channels = oracle.read_exr(mitsuba, out)
            out.unlink()
            stack.append(oracle.rgb(channels))
            if oracle.VARIANCE[0] in channels:
                claimed.append(oracle.rgb(channels, oracle.VARIANCE))
    return np.stack(stack), (np.mean(claimed, axis=0) if claimed else None)


def report_claims(claimed, renders):
    seen = renders.var(axis=0, ddof=1)
    lit = seen > 0
    print(f'claimed variance over observed: {claimed.sum() / seen.sum():.3f} of the image, '
          f'{np.median(claimed[lit] / seen[lit]):.3f} at the median pixel')


def size(text):
    width, height = text.split('x')
    return int(width), int(height)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scene')
    parser.add_argument('--renders', type=int, default=64, help='independent renders a side (64)')
    parser.add_argument('--spp', type=int, default=128, help='samples a pixel in each (128)')
    parser.add_argument('--tilecast', help='the tilecast binary; without it Mitsuba is only tested against itself')
    parser.add_argument('--tilecast-spp', type=int, help="tilecast's samples, where it needs fewer (as --spp)")
    parser.add_argument('--offsets', choices=['exact', 'mitsuba'], help="where tilecast's rays start (exact)")
    parser.add_argument('--cache', default='target/mitsuba-cache', help='where to keep the renders of Mitsuba')
    parser.add_argument('--means', type=float, default=0.002, help='largest difference of the means, relative (0.002)')
    parser.add_argument('--size', type=size, metavar='WxH', help="the picture's, in place of the scene's own")
    parser.add_argument('-D', dest='define', action='append', default=[], metavar='NAME=VALUE', help='scene parameter')
    options = parser.parse_args()
    if options.renders < 2:
        parser.error('--renders must be at least 2: a variance is wanted')
    return options


def main():
    options = arguments()
    mitsuba = oracle.load()
    n = options.renders
    reference = mitsuba_renders(mitsuba, options, 2 * n)
    expected, *_ = compare('mitsuba and itself', reference[n:], reference[:n])
    if options.tilecast is None:
        return 0
    ours, claimed = tilecast_renders(mitsuba, options)
    if ours.shape[1:] != reference.shape[1:]:
        print(f'sizes differ: tilecast {ours.shape[1:]}, mitsuba {reference.shape[1:]}', file=sys.stderr)
        return 1
    pixels, blocks, means, interval = compare('tilecast and mitsuba', ours, reference[:n])
    if interval > options.means:
        print(f'the means are known to {interval:.2%} only: more --renders or --spp to judge them', file=sys.stderr)
    if claimed is not None:
        report_claims(claimed, ours)
    agrees = pixels >= expected - 0.01 and blocks >= 0.99 and means <= options.means
    print('agree' if agrees else 'DISAGREE')
    return 0 if agrees else 1


if __name__ == '__main__':
    sys.exit(main())
