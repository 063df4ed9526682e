"""Makes the reference images in references/ with Mitsuba 3 (pip install mitsuba; LLVM 17 or newer).

    make_references.py              the scenes that have no reference yet
    make_references.py NAME…        these, again
    make_references.py --all        all of them, again (about 6 minutes on two cores)

Every scene is rendered SEEDS times with SPP samples a pixel and independent seeds. Their mean is the reference, and their
spread gives the variance of that mean, whatever the noise looks like. Both go into one EXR with the names that tilecast
writes: R, G, B, Variance.R, Variance.G, Variance.B, SampleCount.
"""
import argparse
import pathlib
import sys
import time

import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / 'bench'))
import mitsuba_oracle as oracle  # noqa: E402

# Many renders give a trustworthy variance; many samples in each keep small the bias of dividing by the filter's weights.
SEEDS, SPP = 32, 256


def make(mitsuba, scene, out):
    loaded = mitsuba.load_file(str(scene))
    stack = np.stack([oracle.render(mitsuba, loaded, SPP, seed) for seed in range(SEEDS)])
    mean, variance = stack.mean(axis=0), stack.var(axis=0, ddof=1) / SEEDS
    oracle.write_reference(mitsuba, out, mean, variance, SEEDS * SPP)
    return mean, np.sqrt(variance)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('names', nargs='*', help='scenes, without .xml')
    parser.add_argument('--all', action='store_true', help='make every reference again')
    options = parser.parse_args()
    mitsuba = oracle.load()
    (HERE / 'references').mkdir(exist_ok=True)
    failed = []
    for scene in sorted((HERE / 'scenes').glob('*.xml')):
        out = HERE / 'references' / f'{scene.stem}.exr'
        if not (options.all or scene.stem in options.names or (not options.names and not out.exists())):
            continue
        start = time.time()
        try:
            mean, error = make(mitsuba, scene, out)
        except Exception as reason:
            failed.append(scene.stem)
            print(f'{scene.stem}: {reason}', flush=True)
            continue
        print(f'{scene.stem}: mean {mean.mean():.4f}, standard error of a pixel {error.mean() / mean.mean():.2%}, '
              f'{time.time() - start:.0f} s', flush=True)
    if failed:
        sys.exit(f'no reference for {", ".join(failed)}')


if __name__ == '__main__':
    main()
