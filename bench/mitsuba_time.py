"""Error against time of Mitsuba 3 on a scene, and of tilecast in turn with it.

    mitsuba_time.py normalise SCENE.xml OUT.xml [--pixels 30000] [--max-depth N]
    mitsuba_time.py reference SCENE.xml REF.exr --spp 16384
    mitsuba_time.py curve     SCENE.xml REF.exr --spp 4,16,64,256 [--variant llvm_ad_rgb] [--threads N] [--tilecast BIN]

`normalise` writes a copy of a scene with what a comparison must fix: film size, box filter (one sample, one pixel, in both
renderers), independent sampler, float32 RGB, and the depth if asked. Give both renderers that copy.
`reference` averages many short renders and writes the mean with its own variance, as `tilecast render` does.
`curve` prints CSV: variant,threads,spp,seconds,cpu_seconds,mse,relmse. Seconds are those of rendering alone, without
loading and without compiling kernels (each sample count is rendered once beforehand); medians of three seeds, errors their
mean. CPU seconds, of all threads together, are the steadier figure on a machine that is not idle.

relmse = mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over pixels and channels.
"""
import argparse
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET

import numpy as np

import mitsuba_oracle as oracle

REFERENCE_PART_SPP = 256
FIRST_REFERENCE_SEED = 100_000
SEEDS = 3


def relmse(image, reference):
    return float(np.mean((image - reference) ** 2 / (reference ** 2 + 0.01 * reference.mean() ** 2)))


def film_size(film, defaults):
    """Width and height that a <film> asks for, with $names resolved; Mitsuba's own default is 768 x 576."""
    size = {'width': 768.0, 'height': 576.0}
    for node in film.findall('integer'):
        if node.get('name') in size:
            value = node.get('value')
            size[node.get('name')] = float(defaults[value[1:]] if value.startswith('$') else value)
    return size['width'], size['height']


def replace_film(sensor, pixels, defaults):
    old = sensor.find('film')
    width, height = film_size(old, defaults) if old is not None else (768.0, 576.0)
    for node in sensor.findall('film') + sensor.findall('sampler'):
        sensor.remove(node)
    scale = math.sqrt(pixels / (width * height))
    film = ET.SubElement(sensor, 'film', type='hdrfilm')
    ET.SubElement(film, 'integer', name='width', value=str(max(1, round(width * scale))))
    ET.SubElement(film, 'integer', name='height', value=str(max(1, round(height * scale))))
    ET.SubElement(film, 'string', name='pixel_format', value='rgb')
    ET.SubElement(film, 'string', name='component_format', value='float32')
    ET.SubElement(film, 'rfilter', type='box')
    ET.SubElement(sensor, 'sampler', type='independent')


def replace_depth(integrator, depth):
    for node in integrator.findall('integer'):
        if node.get('name') in ('max_depth', 'maxDepth'):
            integrator.remove(node)
    ET.SubElement(integrator, 'integer', name='max_depth', value=str(depth))


def normalise(options):
    tree = ET.parse(options.scene)
    root = tree.getroot()
    defaults = {node.get('name'): node.get('value') for node in root.iter('default')}
    for sensor in root.findall('sensor'):
        replace_film(sensor, options.pixels, defaults)
    if options.max_depth is not None:
        for integrator in root.findall('integrator'):
            replace_depth(integrator, options.max_depth)
    # The copy may lie anywhere: the files it names are still found beside the original.
    root.insert(0, ET.Element('path', value=os.path.dirname(os.path.abspath(options.scene))))
    tree.write(options.out)


def reference(options):
    mitsuba = oracle.load()
    scene = oracle.load_scene(mitsuba, options.scene)
    parts = max(2, round(int(options.spp) / REFERENCE_PART_SPP))
    total = squares = 0.0
    for k in range(parts):
        image = oracle.render(mitsuba, scene, REFERENCE_PART_SPP, FIRST_REFERENCE_SEED + k)
        total, squares = total + image, squares + image ** 2
    mean = total / parts
    variance = np.maximum(squares / parts - mean ** 2, 0.0) / (parts - 1)
    oracle.write_reference(mitsuba, options.reference, mean, variance, parts * REFERENCE_PART_SPP)
    print(f'{mean.shape[1]}x{mean.shape[0]}, mean {mean.mean():.6g}, relmse of the reference itself about '
          f'{relmse(mean + np.sqrt(variance), mean):.3g}')


def median_row(name, options, spp, truth, render):
    """One CSV row: medians of the times and means of the errors over SEEDS renders, `render(seed)` -> (s, cpu s, image)."""
    seconds, cpu_seconds, errors = [], [], []
    for seed in range(1, SEEDS + 1):
        wall, cpu, image = render(SEEDS * spp + seed)
        seconds.append(wall)
        cpu_seconds.append(cpu)
        errors.append((np.mean((image - truth) ** 2), relmse(image, truth)))
    mse, relative = np.mean(errors, axis=0)
    times = f'{statistics.median(seconds):.4f},{statistics.median(cpu_seconds):.4f}'
    print(f'{name},{options.threads},{spp},{times},{mse:.6g},{relative:.6g}', flush=True)


def by_mitsuba(mitsuba, scene, spp, seed):
    start, cpu_start = time.perf_counter(), time.process_time()
    image = oracle.render(mitsuba, scene, spp, seed)
    return time.perf_counter() - start, time.process_time() - cpu_start, image


def by_tilecast(mitsuba, options, spp, seed):
    """Seconds are those from submission to the finished film, as --json tells; CPU seconds are of the whole process."""
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, 'out.exr')
        command = [options.tilecast, 'render', options.scene, '--spp', str(spp), '--seed', str(seed), '-o', out,
                   '--threads', str(options.threads), '--json']
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        finished = json.loads(subprocess.run(command, check=True, capture_output=True).stdout.splitlines()[-1])
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return finished['seconds'], cpu, oracle.rgb(oracle.read_exr(mitsuba, out))


def curve(options):
    mitsuba = oracle.load(options.variant)
    scene = oracle.load_scene(mitsuba, options.scene)
    truth = oracle.rgb(oracle.read_exr(mitsuba, options.reference))
    oracle.set_threads(options.threads)
    print('variant,threads,spp,seconds,cpu_seconds,mse,relmse')
    for spp in map(int, options.spp.split(',')):
        oracle.render(mitsuba, scene, spp, 0)
        median_row(options.variant, options, spp, truth, lambda seed: by_mitsuba(mitsuba, scene, spp, seed))
        if options.tilecast:
            median_row('tilecast', options, spp, truth, lambda seed: by_tilecast(mitsuba, options, spp, seed))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser('normalise')
    command.add_argument('scene')
    command.add_argument('out')
    command.add_argument('--pixels', type=float, default=30_000)
    command.add_argument('--max-depth', type=int)
    command.set_defaults(run=normalise)
    for name, run in (('reference', reference), ('curve', curve)):
        command = commands.add_parser(name)
        command.add_argument('scene')
        command.add_argument('reference')
        command.add_argument('--spp', required=True)
        command.set_defaults(run=run)
    command.add_argument('--variant', default='llvm_ad_rgb')
    command.add_argument('--threads', type=int, default=os.cpu_count())
    command.add_argument('--tilecast', help='the tilecast binary, to be timed in turn with Mitsuba')
    options = parser.parse_args()
    options.run(options)


if __name__ == '__main__':
    sys.exit(main())
