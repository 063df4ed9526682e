# What the shell tests share. The sourcing script has `dir`, a folder for logs, `started`, an array of the processes to end, and
# DEADLINE_SECONDS, by which all must be seen.

say() { echo "$(date +%T) $*"; }

# start NAME COMMAND…: in the background, its output in the folder of logs.
start() {
    local name=$1
    shift
    "$@" > "$dir/$name.out" 2> "$dir/$name.err" &
    started+=($!)
}

# until_true WHAT COMMAND…: looks twice a second until the command succeeds.
until_true() {
    local what=$1
    shift
    until "$@"; do
        [ "$SECONDS" -lt "$DEADLINE_SECONDS" ] || { say "waited in vain for: $what"; return 1; }
        sleep 0.5
    done
    say "seen: $what"
}
