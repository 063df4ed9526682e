"""Mitsuba 3 as the renderer to be compared with: loading it, rendering with it, reading and writing EXR with it.

Knows nothing of statistics or of tilecast. Images are float64 arrays of shape (height, width, 3), linear sRGB.
"""
import glob
import os
import pathlib
import re

import numpy as np

VARIANCE = ('Variance.R', 'Variance.G', 'Variance.B')


def load(variant='llvm_ad_rgb'):
    """Import Mitsuba with `variant` chosen. The LLVM variants need LLVM 17 or newer, which Debian keeps where Dr.Jit
    does not look; a library named by DRJIT_LIBLLVM_PATH wins over the one found here."""
    if variant.startswith('llvm'):
        found = glob.glob('/usr/lib/*/libLLVM-[12][0-9].so*') + glob.glob('/usr/lib/*/libLLVM.so.*')
        new_enough = [path for path in sorted(found) if version(path) >= 17]
        if new_enough:
            os.environ.setdefault('DRJIT_LIBLLVM_PATH', new_enough[-1])
    import mitsuba
    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def set_threads(count):
    """Threads that Mitsuba renders with from now on. Call it when everything is loaded: with a single thread, reading
    and writing EXR wait for ever (seen with 3.9.1)."""
    import drjit
    drjit.set_thread_count(count)


def load_scene(mitsuba, path, defines=(), size=None):
    """A scene file with NAME=VALUE parameters, its film perhaps of another size (width, height).

    Samples are independent, whatever the scene asks for: Mitsuba's `ldsampler` ties a sample's place in its pixel to its
    lights, so that wherever a filter's weights are not symmetrical (the first and last column) the mean is off, by more
    than a percent in veach-mis."""
    text = re.sub(r'(<sampler\s+type=)"\w+"', r'\1"independent"', pathlib.Path(path).read_text())
    for name, pixels in zip(('width', 'height'), size or ()):
        text = re.sub(rf'(name="{name}"\s+value=)"[^"]*"', rf'\1"{pixels}"', text)
    mitsuba.file_resolver().prepend(str(pathlib.Path(path).parent))
    return mitsuba.load_string(text, **dict(define.split('=', 1) for define in defines))


def version(library):
    """Major version in the file name of an LLVM library: libLLVM-19.so, libLLVM.so.19.1."""
    digits = os.path.basename(library).replace('libLLVM', '').replace('so', '').strip('-.').split('.')[0]
    return int(digits) if digits.isdigit() else 0


def render(mitsuba, scene, spp, seed):
    """One image with its own seed. Film weights are divided out, so a sample's colour is what the film averages."""
    return np.array(mitsuba.render(scene, spp=spp, seed=seed), dtype=np.float64)[..., :3]


def read_exr(mitsuba, path):
    """Channels of an EXR by name, each (height, width)."""
    bitmap = mitsuba.Bitmap(str(path))
    values = np.array(bitmap, dtype=np.float64)
    values = values.reshape(values.shape[0], values.shape[1], -1)
    return {field.name: values[..., i] for i, field in enumerate(bitmap.struct_())}


def rgb(channels, names=('R', 'G', 'B')):
    """Stack three named channels, (height, width, 3)."""
    return np.stack([channels[name] for name in names], axis=-1)


def write_reference(mitsuba, path, mean, variance, samples):
    """An EXR as `tilecast render` writes them: mean, variance of that mean, and the samples a pixel has."""
    count = np.full(mean.shape[:2] + (1,), samples, dtype=np.float64)
    values = np.concatenate([mean, variance, count], axis=-1).astype(np.float32)
    names = ['R', 'G', 'B', *VARIANCE, 'SampleCount']
    kind = mitsuba.Bitmap.PixelFormat.MultiChannel
    mitsuba.Bitmap(values, pixel_format=kind, channel_names=names).write(str(path))
