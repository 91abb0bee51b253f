"""docs/security.md: every test that it names exists, and its table of unsafe code is complete."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
REFERENCES = sorted(set(re.findall(r"`([\w/]+\.(?:py|rs))::(\w+)`", TEXT)))
#: Pattern of unsafe blocks, functions and trait implementations, without attributes and comments.
UNSAFE = re.compile(r"^(?!\s*//).*\bunsafe (?:\{|fn|impl|extern)", re.MULTILINE)


def section(title: str) -> str:
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize(("file", "name"), REFERENCES)
def test_a_named_test_exists(file, name):
    text = (ROOT / file).read_text(encoding="utf-8")
    pattern = rf"^def {name}\(" if file.endswith(".py") else rf"#\[test\]\nfn {name}\("
    assert re.search(pattern, text, re.MULTILINE), f"{file} has no test {name}"


def test_every_hazard_and_threat_names_a_test_or_says_that_nothing_stops_it():
    rows = [
        line
        for title in ("Threat model", "Hazards")
        for line in section(title).splitlines()
        if line.startswith("| ") and not line.startswith(("| from", "| hazard"))
    ]
    assert len(rows) > 30
    assert not [row for row in rows if "::" not in row and "**nothing**" not in row]


def test_every_file_with_unsafe_code_names_the_run_that_covers_it():
    table = section("Undefined behaviour")
    covered = re.findall(r"`((?:rust|fuzz)/[\w/.]+|\w+\.rs)`", table)
    files = [
        path.relative_to(ROOT).as_posix()
        for folder in ("rust", "fuzz/src")
        for path in (ROOT / folder).rglob("*.rs")
        if UNSAFE.search(path.read_text(encoding="utf-8"))
    ]
    assert len(files) >= 8
    missing = [
        file
        for file in files
        if not any(
            file == prefix or file.startswith(f"{prefix}/") or file.endswith(f"/{prefix}")
            for prefix in covered
        )
    ]
    assert not missing, f"not in the table of docs/security.md: {missing}"


def test_every_fuzz_target_is_described_has_a_program_and_a_corpus():
    targets = re.findall(r'^    \("(\w+)", ', (ROOT / "fuzz/src/lib.rs").read_text(), re.MULTILINE)
    programs = {path.stem for path in (ROOT / "fuzz/fuzz_targets").glob("*.rs")}
    corpora = {path.name for path in (ROOT / "fuzz/corpus").iterdir()}
    described = set(re.findall(r"^\| `(\w+)` \|", section("Fuzzing"), re.MULTILINE))
    assert set(targets) == programs == corpora == described
