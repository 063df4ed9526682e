#!/usr/bin/env bash
# What distribution costs: pairs of `--workers 2 --threads 1` and in-process `--threads 2`, in turn, and the ratio of the
# medians of their wall times. Usage: bench/distribution.sh SCENE [SPP] [PAIRS]; the machine should have nothing else to do.
set -euo pipefail
scene=$1 spp=${2:-256} pairs=${3:-5}
tilecast=$(dirname "$0")/../target/release/tilecast
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
one() {
    local start=$EPOCHREALTIME
    "$tilecast" render "$scene" --size 512x512 --spp "$spp" -o "$out/image.exr" --quiet "${@:2}"
    echo "$EPOCHREALTIME $start" | awk '{ printf "%.3f\n", $1 - $2 }' | tee -a "$out/$1"
}
median() { sort -n "$1" | awk '{ t[NR] = $1 } END { print (t[int((NR + 1) / 2)] + t[int(NR / 2) + 1]) / 2 }'; }
for _ in $(seq "$pairs"); do
    one processes --workers 2 --threads 1
    one here --threads 2
done
awk -v a="$(median "$out/processes")" -v b="$(median "$out/here")" \
    'BEGIN { printf "median with processes %.3f s, in one process %.3f s, ratio %.4f\n", a, b, a / b }'
