#!/bin/sh
# Mutation tests of the laws: changes one operator or result at a time, and runs the quick tests of the core.
# usage: mutants.sh SHARD   (k/n: the k-th of n parts, from 0; 0/1 is everything and takes a night on two idle cores)
# Needs cargo-mutants and cargo-nextest. Results go into build/mutants.
set -eu
shard=$1
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"

skip() {
    printf '\n!! SKIPPED: mutants: %s\n' "$1"
    exit 0
}
command -v cargo-mutants >/dev/null || skip "cargo-mutants is not installed (cargo install --locked cargo-mutants)"
command -v cargo-nextest >/dev/null || skip "cargo-nextest is not installed (cargo install --locked cargo-nextest)"
mkdir -p build/mutants
# Round robin over the files, so that each part samples all of them.
cargo mutants --package pliant-core --file 'rust/core/src/law/*.rs' --file 'rust/core/src/task/*.rs' \
    --file 'rust/core/src/command/*.rs' --file 'rust/core/src/controller/*.rs' \
    --test-tool nextest --shard "$shard" --sharding round-robin --timeout 600 --minimum-test-timeout 120 \
    --output build/mutants --no-shuffle --colors never
