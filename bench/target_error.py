"""Is the error that was asked for the one that an image has, and what did samples where the noise is save?

    python bench/target_error.py SCENE --size WxH --target 0.02 --reference SPP --seeds 20 --tilecast target/release/tilecast

Renders a reference of SPP samples a pixel, then images with `--target-error`, one a seed, and two even images for the law by which their
error falls. Errors are √(Σ (image − reference)² / Σ reference²) over pixels and channels, less the variance of the reference. Reading EXR
takes Mitsuba (bench/README.md).
"""

import argparse
import json
import pathlib
import subprocess
import tempfile

import mitsuba_oracle as oracle
import numpy as np


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scene')
    parser.add_argument('--size', required=True, metavar='WxH')
    parser.add_argument('--target', type=float, required=True)
    parser.add_argument('--reference', type=int, required=True, metavar='SPP')
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--tilecast', default='target/release/tilecast')
    options = parser.parse_args()
    mitsuba = oracle.load('scalar_rgb')
    width, height = map(int, options.size.split('x'))

    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder) / 'image.exr'

        def render(*arguments):
            command = [options.tilecast, 'render', options.scene, '--size', options.size, '-o', out, '--no-film', '--json', *arguments]
            lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
            channels = oracle.read_exr(mitsuba, out)
            return json.loads(lines[-1]), oracle.rgb(channels).astype(np.float64), channels

        _, truth, channels = render('--spp', str(options.reference), '--seed', '999')
        power, unsure = (truth**2).sum(), oracle.rgb(channels, oracle.VARIANCE).astype(np.float64).sum()
        print(f'reference: {options.reference} samples a pixel, relative error {np.sqrt(unsure / power):.5f}', flush=True)

        def error(image):
            return np.sqrt(max(((image - truth) ** 2).sum() - unsure, 0) / power)

        reached, spent = [], []
        for seed in range(options.seeds):
            finished, image, _ = render('--target-error', str(options.target), '--seed', str(seed))
            reached.append(error(image) / options.target)
            spent.append(finished['samples_traced'] / (width * height))
            claimed = finished['relative_error'] / options.target
            print(f'seed {seed}: {reached[-1]:.3f} of the target, claims {claimed:.3f}; {spent[-1]:.0f} samples a pixel', flush=True)
        reached, spent = np.array(reached), np.array(spent)
        within = ((reached >= 0.9) & (reached <= 1.05)).sum()
        print(f'within 0.9 and 1.05 of the target: {within} of {options.seeds}; {reached.min():.3f} to {reached.max():.3f}, mean {reached.mean():.3f}')

        # An even image with as many samples, and with twice as many: what the same error would have taken.
        counts = [round(spent.mean() / 4) * 4 * factor for factor in (1, 2)]
        even = [np.sqrt(np.mean([error(render('--spp', str(n), '--seed', str(1000 + k))[1]) ** 2 for k in range(4)])) for n in counts]
        slope = np.log(even[0] / even[1]) / np.log(2)
        typical = np.sqrt((reached**2).mean()) * options.target
        needed = counts[0] * (even[0] / typical) ** (1 / slope)
        print(f'even images: {even[0]:.5f} with {counts[0]}, {even[1]:.5f} with {counts[1]}; {needed:.0f} samples a pixel for {typical:.5f}')
        print(f'spent {spent.mean():.0f} samples a pixel, the pilot included: {1 - spent.mean() / needed:.1%} less')


if __name__ == '__main__':
    main()
