#!/usr/bin/env bash
# The link between coordinator and workers is cut, again and again, for 1 to 30 s each: a network namespace each, joined by a
# veth pair whose end is taken down. Nobody helps; the image has the digest of a local render, and no sample is lost.
# Needs root and `ip` (Debian's iproute2), and changes nothing outside its own two namespaces. Takes some minutes.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/shell.sh

CUTS=${CUTS:-6}
SEED=${SEED:-$RANDOM}
DEADLINE_SECONDS=${DEADLINE_SECONDS:-1500}
# Long enough to outlast the cuts on one core.
SIZE=${SIZE:-256x256}
SPP=${SPP:-512}
tilecast=${TILECAST:-$PWD/target/release/tilecast}
scene=$PWD/scenes/cornell-box/scene.xml
here=tilecast-a-$$
there=tilecast-b-$$

if ! ip netns add "$here" 2> /dev/null; then
    echo "NOT RUN: this machine allows no network namespaces (\`ip netns add\` failed; it takes root and iproute2)" >&2
    exit "${NOT_RUN_STATUS:-77}"
fi
dir=$(mktemp -d)
started=()
trap 'status=$?; kill "${started[@]}" 2> /dev/null || true; wait || true
      ip netns del "$here" || true; ip netns del "$there" 2> /dev/null || true
      [ "$status" -eq 0 ] && rm -rf "$dir" || echo "FAILED with SEED=$SEED; logs are in $dir" >&2' EXIT

ip netns add "$there"
ip link add veth0 netns "$here" type veth peer name veth0 netns "$there"
ip -n "$here" address add 10.77.0.1/24 dev veth0
ip -n "$there" address add 10.77.0.2/24 dev veth0
for name in "$here" "$there"; do
    ip -n "$name" link set lo up
    ip -n "$name" link set veth0 up
done

cd "$dir"
RANDOM=$SEED
"$tilecast" render "$scene" --size "$SIZE" --spp "$SPP" --quiet -o local.exr
"$tilecast" certs init certs > /dev/null
start coordinator ip netns exec "$here" "$tilecast" coordinator --listen 10.77.0.1:7878 --certs certs --json
until_true "the coordinator" grep -qs listening coordinator.out
for i in 1 2; do
    start "worker$i" ip netns exec "$there" "$tilecast" worker --connect 10.77.0.1:7878 --certs certs --threads 1
done
start submit ip netns exec "$here" "$tilecast" submit "$scene" --size "$SIZE" --spp "$SPP" --connect 10.77.0.1:7878 \
    --certs certs --json -o cut.exr
submit=${started[-1]}
until_true "work" grep -qs progress submit.out
for ((i = 1; i <= CUTS; i++)); do
    sleep "$((1 + RANDOM % 4)).$((RANDOM % 10))"
    kill -0 "$submit" 2> /dev/null || { say "the image was there after $((i - 1)) cuts; give a larger SPP"; break; }
    seconds=$((1 + RANDOM % 30))
    say "cut $i: $seconds s"
    ip -n "$there" link set veth0 down
    sleep "$seconds"
    ip -n "$there" link set veth0 up
done
[ "$i" -gt 1 ] || exit 1
wait "$submit"
cmp local.exr cut.exr
say "$((i - 1)) cuts, seed $SEED: the image of a local render, to the byte"
