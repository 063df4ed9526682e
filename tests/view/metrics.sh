#!/usr/bin/env bash
# Metrics of a coordinator with a worker and a job, judged by Prometheus' own tool.
set -euo pipefail
cd "$(dirname "$0")/../.."
tilecast=${TILECAST:-target/release/tilecast}
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT
"$tilecast" coordinator --json --listen 127.0.0.1:0 --http 127.0.0.1:0 >"$folder/said" 2>"$folder/log" &
until grep -q viewing "$folder/said"; do sleep 0.1; done
address=$(sed -n 's/.*"address":"\([^"]*\)".*/\1/p' "$folder/said")
url=$(sed -n 's/.*"url":"\([^"]*\)".*/\1/p' "$folder/said")
"$tilecast" worker --connect "$address" --threads 1 --name "a worker" 2>"$folder/worker" &
"$tilecast" submit scenes/cornell-box/scene.xml --connect "$address" --size 64x64 --spp 64 --quiet -o "$folder/done.exr"
"$tilecast" submit scenes/cornell-box/scene.xml --connect "$address" --size 64x64 --spp 4000000 --quiet -o "$folder/image.exr" 2>/dev/null &
until curl -s "${url}metrics" | grep -q tilecast_job_left_seconds; do sleep 0.2; done
curl -s "${url}metrics" | tee "$folder/metrics" | promtool check metrics
echo "ok: $(grep -c '^# TYPE' "$folder/metrics") metrics, $(grep -vc '^#' "$folder/metrics") lines, and promtool is content"
