#!/usr/bin/env bash
# Runs submit.py against a coordinator and a worker that it starts and ends. First argument: a Python with grpcio-tools.
set -euo pipefail
cd "$(dirname "$0")/../.."
python=${1:-python3}
tilecast=${TILECAST:-$PWD/target/release/tilecast}
dir=$(mktemp -d)
started=()
trap 'kill "${started[@]}" 2> /dev/null || true; wait || true; rm -rf "$dir"' EXIT

"$tilecast" coordinator --listen 127.0.0.1:0 --json > "$dir/coordinator" 2> /dev/null &
started+=($!)
until grep -q listening "$dir/coordinator"; do sleep 0.1; done
address=$(grep -o '127.0.0.1:[0-9]*' "$dir/coordinator")
"$tilecast" worker --connect "$address" --threads 1 2> /dev/null &
started+=($!)
# A job whose scene the example takes up.
"$tilecast" submit scenes/cornell-box/scene.xml --size 64x64 --spp 8 --connect "$address" --quiet -o "$dir/image.exr"
job=$("$tilecast" status --json --connect "$address" | "$python" -c 'import json, sys
print([j["job"] for j in map(json.loads, sys.stdin) if j["kind"] == "job"][-1])')
"$python" -m grpc_tools.protoc -I proto/proto --python_out="$dir" --grpc_python_out="$dir" render.proto
PYTHONPATH=$dir "$python" examples/python/submit.py "$address" "$job" --spp 256
