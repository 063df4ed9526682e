"""Mitsuba 3 as a peer of `tilecast bench`: loads the scene named first, answers 0, then for each line "SPP SEED FILE" renders,
writes the image and answers the seconds that rendering took. Ends when its input does."""
import glob
import os
import sys
import time


def load():
    # The LLVM variants need LLVM 17 or newer, which Debian keeps where Dr.Jit does not look.
    names = glob.glob('/usr/lib/*/libLLVM-[12][0-9].so*') + glob.glob('/usr/lib/*/libLLVM.so.*')
    if names:
        os.environ.setdefault('DRJIT_LIBLLVM_PATH', sorted(names)[-1])
    import mitsuba
    mitsuba.set_variant('llvm_ad_rgb')
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def main():
    mitsuba = load()
    import numpy as np
    scene = mitsuba.load_file(sys.argv[1])
    print(0, flush=True)
    for line in sys.stdin:
        spp, seed, path = line.rstrip('\n').split(' ', 2)
        begun = time.perf_counter()
        image = np.array(mitsuba.render(scene, spp=int(spp), seed=int(seed)), dtype=np.float32)[..., :3]
        seconds = time.perf_counter() - begun
        mitsuba.Bitmap(np.ascontiguousarray(image)).write(path)
        print(seconds, flush=True)


main()
