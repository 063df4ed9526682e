#!/usr/bin/env bash
# `tilecast launch slurm` with a real Slurm: slurmctld and three slurmd on this machine. Workers go from 0 to 3 to 1; a node dies in
# mid-render, another worker is ended by its walltime; the image has the digest of a local render.
# Needs Debian's slurm-wlm and python3. Takes some ten minutes on two idle cores. Starts nothing that it does not end.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/shell.sh

# Traced on one core of this machine, the image takes about so long.
WORK_SECONDS=${WORK_SECONDS:-400}
DEADLINE_SECONDS=${DEADLINE_SECONDS:-1500}
tilecast=${TILECAST:-$PWD/target/release/tilecast}
scene=$PWD/scenes/cornell-box/scene.xml
dir=$(mktemp -d)
started=()
trap 'status=$?; kill "${started[@]}" 2> /dev/null || true; wait || true
      [ "$status" -eq 0 ] && rm -rf "$dir" || echo "FAILED; logs are in $dir" >&2' EXIT

free_ports() {
    python3 -c 'import socket
sockets = [socket.socket() for _ in range(4)]
for s in sockets: s.bind(("127.0.0.1", 0))
print(*(s.getsockname()[1] for s in sockets))'
}
# The last `"KEY":VALUE` of the JSON lines in FILE.
field() { python3 -c 'import json, sys
print([json.loads(l)[sys.argv[1]] for l in open(sys.argv[2]) if sys.argv[1] in json.loads(l)][-1])' "$1" "$2"; }

# ---- Slurm
export SLURM_CONF=$dir/slurm.conf
read -r -a ports <<< "$(free_ports)"
sed -e "s|DIR|$dir|; s|HOST|$(hostname -s)|; s|USER|$(id -un)|" \
    -e "s|PORT0|${ports[0]}|; s|PORT1|${ports[1]}|; s|PORT2|${ports[2]}|; s|PORT3|${ports[3]}|" tests/slurm/slurm.conf > "$SLURM_CONF"
mkdir -p "$dir/state" "$dir"/spool-n{1,2,3}
start slurmctld slurmctld -D -f "$SLURM_CONF"
for node in n1 n2 n3; do start "$node" slurmd -D -N "$node" -f "$SLURM_CONF"; done
idle() { [ "$(sinfo --noheader --Node --states=idle --format=%N 2> /dev/null | wc -l)" -eq 3 ]; }
until_true "three idle nodes" idle

# ---- coordinator, launcher, job
start coordinator "$tilecast" coordinator --listen 127.0.0.1:0 --json
listening() { grep -q listening "$dir/coordinator.out"; }
until_true "a coordinator" listening
address=$(field address "$dir/coordinator.out")
start launcher "$tilecast" launch slurm --workers 3 --threads 1 --walltime 10m --work-each 20s --patience 5s \
    --connect "$address" -- --output="$dir/task-%A-%a.log"
launcher=${started[-1]}

tasks() { squeue --noheader --array --states="$1" --format=%i | wc -l; }
running() { [ "$(tasks R)" -eq "$1" ]; }
workers() { [ "$("$tilecast" status --json --connect "$address" | grep -c '"kind":"worker"')" -eq "$1" ]; }
sleep 7
running 0 && [ "$(tasks all)" -eq 0 ]
say "seen: nothing to do, no worker"

"$tilecast" render "$scene" --size 256x256 --spp 64 --threads 1 --json -o "$dir/pace.exr" --no-film > "$dir/pace.out"
spp=$(python3 -c "print(max(64, int($(field samples_per_second "$dir/pace.out") * $WORK_SECONDS / 65536)))")
say "submitting $spp samples a pixel"
start submit "$tilecast" submit "$scene" --size 256x256 --spp "$spp" --connect "$address" --json -o "$dir/far.exr"
submit=${started[-1]}
until_true "three workers at work" workers 3
running 3

# ---- a task that its walltime ends; a node that dies
limited=$(squeue --noheader --array --nodelist=n1 --format=%A)
scontrol update JobId="$limited" TimeLimit=1
say "task $limited on n1 may run one minute"
on_n2=$(squeue --noheader --array --nodelist=n2 --format=%F_%K)
worker=$("$tilecast" status --json --connect "$address" | grep -- "-$on_n2\"" | python3 -c 'import json, sys; print(json.load(sys.stdin)["pid"])')
stepd=$(ps -o ppid= -p "$worker")
kill -9 "$(cat "$dir/n2.pid")" $stepd "$worker"
say "killed n2's slurmd, its stepd and worker $worker of task $on_n2"
requeued() { [ "$(scontrol show job "$on_n2" | grep -o 'Restarts=[0-9]*')" = "Restarts=1" ]; }
until_true "task $on_n2 queued again" requeued
start n2-again slurmd -D -N n2 -f "$SLURM_CONF"
timed_out() { scontrol show job "$limited" | grep -q "JobState=TIMEOUT"; }
until_true "task $limited ended by its walltime" timed_out
until_true "three workers again" workers 3

# ---- less work, fewer workers; the image
until_true "one worker for the rest" running 1
kill -0 "$submit"
say "the job still goes on"
wait "$submit"
until_true "none without work" running 0
kill -TERM "$launcher"
wait "$launcher"
say "rendering the same here"
"$tilecast" render "$scene" --size 256x256 --spp "$spp" --json -o "$dir/here.exr" > "$dir/here.out"
far=$(field digest "$dir/submit.out") here=$(field digest "$dir/here.out")
[ "$far" = "$here" ] || { say "digests differ: $far, here $here"; exit 1; }
sed 's/^/launcher: /' "$dir/launcher.err" | cut -c 1-160
say "digest $far, the same as here. PASSED"
