#!/bin/sh
# Runs every fuzz target of fuzz/ for some minutes each, from its stored corpus; docs/security.md says what they check.
# usage: fuzz.sh MINUTES [TARGET ...]
# Needs rustup's nightly toolchain and cargo-fuzz. New inputs go into build/fuzz, inputs that fail into fuzz/artifacts.
set -eu
minutes=$1
shift
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"

skip() {
    printf '\n!! SKIPPED: fuzz: %s\n' "$1"
    exit 0
}
cargo +nightly --version >/dev/null 2>&1 || skip "no nightly toolchain (rustup toolchain install nightly)"
command -v cargo-fuzz >/dev/null || skip "cargo-fuzz is not installed (cargo install --locked cargo-fuzz)"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$root/build/fuzz/target}"

[ $# -gt 0 ] || set -- $(cargo +nightly fuzz list)
failed=
for name in "$@"; do
    printf '\n== fuzz %s, %s min\n' "$name" "$minutes"
    mkdir -p "build/fuzz/$name"
    dictionary=fuzz/dictionaries/$name.dict
    # URDF inputs are long; the other targets read at most a few hundred bytes.
    [ -f "$dictionary" ] && length=8192 || length=1024
    log=build/fuzz/$name.log
    cargo +nightly fuzz run "$name" "build/fuzz/$name" "fuzz/corpus/$name" -- -max_total_time=$((minutes * 60)) \
        -max_len=$length -timeout=20 -rss_limit_mb=2048 -print_final_stats=1 \
        $([ -f "$dictionary" ] && echo "-dict=$dictionary") >"$log" 2>&1 || failed="$failed $name"
    grep -E 'DONE|stat::number_of_executed_units|panicked|ERROR' "$log" || tail -n 5 "$log"
done
[ -z "$failed" ] || { printf '\nerror: findings in%s: logs in build/fuzz, inputs in fuzz/artifacts\n' "$failed"; exit 1; }
