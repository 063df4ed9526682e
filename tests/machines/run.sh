#!/usr/bin/env bash
# Two machines, as docs/first-cluster.md has them: two network namespaces with a cable between them, each with a folder of its own and
# nothing else in common. What a newcomer does, and the mistakes on the way, each of which must be told what to do about. Needs root.
set -euo pipefail
cd "$(dirname "$0")/../.."
root=$PWD
tilecast=${TILECAST:-$root/target/release/tilecast}
near=tilecast-near-$$ far=tilecast-far-$$
host=10.97.0.1 other=10.97.0.2
folder=$(mktemp -d)
end() {
    for space in $near $far; do
        ip netns pids $space 2>/dev/null | xargs -r kill 2>/dev/null || true
        ip netns del $space 2>/dev/null || true
    done
    rm -rf "$folder"
}
trap end EXIT

for space in $near $far; do
    ip netns add $space
    ip -n $space link set lo up
    mkdir "$folder/$space"
done
ip link add tc-near-$$ netns $near type veth peer name tc-far-$$ netns $far
ip -n $near addr add $host/24 dev tc-near-$$ && ip -n $near link set tc-near-$$ up
ip -n $far addr add $other/24 dev tc-far-$$ && ip -n $far link set tc-far-$$ up

# on MACHINE COMMAND...: runs it there, in its folder and an empty home.
on() {
    local space=$1
    shift
    (cd "$folder/$space" && HOME=$folder/$space ip netns exec "$space" "$@")
}
# says FILE TEXT: what a command said has the text.
says() {
    grep -qF -- "$2" "$1" || { echo "expected: $2, and it said:"; cat "$1"; exit 1; }
    echo "ok: $(grep -F -- "$2" "$1" | head -1 | cut -c1-300)"
}
said=$folder/said
fails() {
    local text=$1
    shift
    if on "$@" >"$said" 2>&1; then echo "went well and should not: $*"; exit 1; fi
    says "$said" "$text"
}

# Alone, on one machine.
on $near "$tilecast" render "$root/scenes/cornell-box/scene.xml" --quiet -o alone.exr

# What one might try first, without certificates.
fails "make certificates with \`tilecast certs init certs\` and add --certs certs" $near "$tilecast" coordinator --listen 0.0.0.0:7878
fails "no coordinator.pem there; on the coordinator's machine \`tilecast certs init certs\` makes all" $near timeout 5 "$tilecast" coordinator --listen 0.0.0.0:7878 --certs certs

# Once, and the three commands.
on $near "$tilecast" certs init certs >"$said" 2>&1
cat "$said"
on $near "$tilecast" coordinator --listen 0.0.0.0:7878 --certs certs --state state >"$folder/coordinator" 2>&1 &
until grep -q 7878 "$folder/coordinator"; do sleep 0.1; done
says "$folder/coordinator" "tilecast worker --connect"
# The worker's machine has no certificates yet, then not the right ones.
fails "certs" $far timeout 20 "$tilecast" worker --connect $host:7878 --certs certs
on $far timeout 4 "$tilecast" worker --connect $host:7878 >"$said" 2>&1 || true
says "$said" "hangs up at the first word"
mkdir "$folder/$far/certs"
cp "$folder/$near/certs/ca.pem" "$folder/$far/certs/"
fails "no certificate and key of a worker" $far timeout 20 "$tilecast" worker --connect $host:7878 --certs certs
cp "$folder/$near/certs"/worker.{pem,key} "$folder/$far/certs/"
fails "no certificate and key of a client" $far "$tilecast" status --connect $host:7878 --certs certs
on $far "$tilecast" worker --connect $host:7878 --certs certs --name far >"$folder/worker" 2>&1 &
on $near "$tilecast" submit "$root/scenes/cornell-box/scene.xml" --connect $host:7878 --certs certs -o cornell.exr >"$said" 2>&1
cat "$said"
on $near "$tilecast" status --connect $host:7878 --certs certs
on $near "$tilecast" compare alone.exr cornell.exr >"$said" 2>&1 || true
grep -o '"digest": *"[0-9a-f]*"' "$folder/$near"/{alone,cornell}.json | cut -d: -f2- | sort -u | wc -l | grep -qx 1
says "$folder/worker" "registered"
echo "ok: two machines made the image of one"
