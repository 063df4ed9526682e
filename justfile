# Recipes for working on tilecast. `just check` is what CI runs.

# Everything a change must pass.
check:
    bash .ci/run

# All tests.
test:
    cargo test --workspace --release

# One part of the whole-system tests, by module: `just system digest`.
system module="":
    cargo test --release --test system -- {{module}}

# The long tests of the cluster: real processes killed 100 times each, 100 liars, what safety costs, a flood of a minute, 10,000
# simulated clusters. Hours. What is measured is on stderr; the machine should have nothing else to do meanwhile.
soak:
    TILECAST_RUNS=100 cargo test --release --test system -- faults liars --nocapture
    TILECAST_RUNS=100 cargo test --release --test system -- costs flood --nocapture --test-threads 1 --include-ignored
    TMPDIR=/dev/shm TILECAST_SEEDS=10000 cargo test --release -p tilecast-coordinator sim

# So many workers over gRPC, and what they cost the coordinator. Each takes an open file there and one in the test.
crowd workers="10000":
    TILECAST_CROWD={{workers}} cargo test --release --test system -- crowd --nocapture

# Cuts the link between coordinator and workers for 1 to 30 s, several times. Needs root and iproute2; says so where it cannot run.
netns:
    cargo build --release
    bash tests/netns/run.sh

# Ten minutes of made-up bytes for each reader of files, the wire and the journal (needs nightly Rust and `cargo install cargo-fuzz`).
# What is found goes to fuzz/corpus, which ordinary tests replay; only keep what is small. In memory, files cost a tenth.
fuzz seconds="600":
    export TMPDIR=/dev/shm; for target in xml obj ply serialized texture wire film journal; do \
        (cd fuzz && cargo +nightly fuzz run --fuzz-dir . --sanitizer none $target -- -max_total_time={{seconds}} -max_len=20000 -rss_limit_mb=2048 -timeout=10) || exit 1; \
    done

# The live page in a real browser, with killed workers and coordinators, and the metrics as Prometheus' own tool reads them. Needs
# node, Debian's chromium and prometheus. `just view docs` takes the pictures of docs/live.md.
view pictures="":
    cargo build --release
    cd tests/view && npm install --no-save --no-audit --no-fund playwright-core
    cd tests/view && PICTURES="{{ if pictures == "" { "" } else { justfile_directory() / pictures } }}" node view.mjs
    bash tests/view/metrics.sh

# What looking on costs a render: by turns with nobody, an open page, pages and a tev that stall. The table of docs/live.md. An hour.
cost *flags:
    cargo build --release
    python3 tests/view/cost.py {{flags}}

# Formats everything.
fmt:
    cargo fmt --all

# Licences, advisories, bans and sources of every dependency (needs `cargo install cargo-deny`).
deny:
    cargo deny check

# The comparison of strategies: docs/strategies.csv and docs/strategies.svg. Minutes.
strategies:
    cargo run --release -p tilecast-bench --bin strategies -- scenes/cornell-box/scene.xml

# The long forms of the tests that say how right images are: docs/accuracy.md.
accuracy:
    TILECAST_LONG=1 cargo test --release -p tilecast-core --test truths -- --nocapture

# Which random numbers? The tables of docs/sampling.md, for these scenes.
samplers +scenes:
    cargo run --release -p tilecast-bench --bin samplers -- {{scenes}}
    cargo run --release -p tilecast-bench --bin samplers -- --sampler sobol --replicates 1,2,4,8 --seeds 6 {{scenes}}

# Is the image right? Compares with Mitsuba 3; bench/README.md says how to install it.
agreement scene="scenes/cornell-box/scene.xml":
    cargo build --release
    venv/bin/python bench/mitsuba_agreement.py {{scene}} --renders 64 --spp 128 --tilecast target/release/tilecast

# The README's picture.
picture:
    cargo run --release -- render scenes/cornell-box/scene.xml --spp 256 --size 384x384 --preview -o scenes/cornell-box/cornell-box.exr
    rm scenes/cornell-box/cornell-box.exr

# `tilecast launch slurm` with a real Slurm, all on this machine: needs Debian's slurm-wlm. Some ten minutes.
slurm:
    cargo build --release
    bash tests/slurm/run.sh

# The chart as Helm renders it, checked in, and checked against Kubernetes' schemas (Python 3.12: `pip install helm-sdkpy kubernetes-validate`).
chart python="venv/bin/python":
    {{python}} deploy/helm/render.py render > deploy/helm/rendered.yaml
    {{python}} -m kubernetes_validate --strict --kubernetes-version 1.33 deploy/helm/rendered.yaml

# The Python example against a coordinator of its own (`pip install grpcio grpcio-tools`).
python python="venv/bin/python":
    cargo build --release
    bash examples/python/run.sh {{python}}

# Two machines, as docs/first-cluster.md has them, in network namespaces, with a newcomer's mistakes on the way. Needs root.
machines:
    cargo build --release
    bash tests/machines/run.sh
