"""Checks of `make release-check` that need no build: versions, tag, pins, and damaged files."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools"))
try:
    import release_check
finally:
    sys.path.pop(0)

FILES = (
    "Cargo.toml",
    "Cargo.lock",
    "fuzz/Cargo.lock",
    "CITATION.cff",
    "CHANGELOG.md",
    "THIRD_PARTY_LICENSES",
    "tools/wheels.sh",
    ".github/workflows/release.yml",
    "integrations/lerobot/pyproject.toml",
)


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """Copy the files that the checks read, and commit them."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", "--all")
    git(tmp_path, "commit", "--quiet", "--message", "release")
    monkeypatch.setattr(release_check, "ROOT", tmp_path)
    run = release_check.run
    monkeypatch.setattr(
        release_check,
        "run",
        lambda *command, **options: run(*command, **{"cwd": tmp_path, **options}),
    )
    monkeypatch.delenv("GITHUB_REF_TYPE", raising=False)
    return tmp_path


def git(folder, *arguments):
    names = ("-c", "user.name=A", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *names, *arguments], cwd=folder, check=True)


def change(path, before, after):
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), encoding="utf-8")


def version():
    return release_check.versions().split()[0]


def test_version_agrees_everywhere(clone):
    current = version()
    change(clone / "CITATION.cff", f"version: {current}", "version: 9.9.9")
    with pytest.raises(release_check.CheckError, match=r"CITATION.cff has 9\.9\.9"):
        release_check.versions()


def date(clone, text):
    heading, stated = release_check.first_heading()
    change(clone / "CHANGELOG.md", f"## [{heading}] - {stated}", f"## [{heading}] - {text}")


def test_tag_is_the_version_and_the_changelog_is_dated(clone):
    current = version()
    date(clone, "unreleased")
    assert f"v{current} is the one to set" in release_check.tag("HEAD")
    git(clone, "tag", f"v{current}")
    with pytest.raises(release_check.CheckError, match="no date: 'unreleased'"):
        release_check.tag("HEAD")
    date(clone, "2026-01-31")
    assert release_check.tag("HEAD") == f"v{current} is the version, of 2026-01-31"
    git(clone, "tag", "v9.9.9")
    with pytest.raises(release_check.CheckError, match=rf"v9\.9\.9, its version is v{current}"):
        release_check.tag("HEAD")


def test_tag_that_started_the_workflow_counts(clone, monkeypatch):
    monkeypatch.setenv("GITHUB_REF_TYPE", "tag")
    monkeypatch.setenv("GITHUB_REF_NAME", "v9.9.9")
    with pytest.raises(release_check.CheckError, match=r"has the tag v9\.9\.9"):
        release_check.tag("HEAD")


def test_programs_of_the_workflow_have_a_version(clone, monkeypatch):
    monkeypatch.setattr(release_check, "run", lambda *_, **__: "")
    assert "crates with checksums" in release_check.pins()
    change(clone / ".github/workflows/release.yml", "cargo-deny@", "cargo-deny #")
    with pytest.raises(release_check.CheckError, match=r"release\.yml: cargo-deny has no version"):
        release_check.pins()


@pytest.mark.parametrize(
    ("file", "before", "after", "message"),
    [
        ("Cargo.toml", "[workspace.package]", "[workspace.packages]", "no entry workspace.package"),
        ("Cargo.toml", "[workspace", "[workspace\n", "Cargo.toml: "),
        ("fuzz/Cargo.lock", '[[package]]\nname = "', '[[package]]\nnames = "', "no entry name"),
        ("CHANGELOG.md", "## [", "## ", "no heading such as"),
        ("CITATION.cff", "\nversion: ", "\nversions: ", "CITATION.cff has None"),
        ("integrations/lerobot/pyproject.toml", "[project]", "[projects]", "no entry project"),
        ("Cargo.lock", None, None, "Cargo.lock: .*No such file"),
    ],
)
def test_a_damaged_file_is_named(clone, file, before, after, message):
    if before is None:
        (clone / file).unlink()
    else:
        change(clone / file, before, after)
    with pytest.raises(release_check.CheckError, match=message):
        release_check.versions()


def test_a_damaged_archive_or_bill_is_named(clone, tmp_path, monkeypatch):
    monkeypatch.setattr(release_check, "run", lambda *_, **__: "")
    wheel, bill = tmp_path / "pliant-0-py3-none-any.whl", tmp_path / "pliant.cdx.json"
    wheel.write_bytes(b"PK")
    with pytest.raises(release_check.CheckError, match="not a zip file"):
        release_check.contents(wheel)
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("pliant/__init__.py", "")
    with pytest.raises(release_check.CheckError, match=r"0 of .*licenses/LICENSE"):
        release_check.contents(wheel)
    for content, message in (
        ("{", "pliant.cdx.json: "),
        ("{}", "no entry components"),
        (json.dumps({"components": [{}]}), "no entry name"),
        (json.dumps({"components": []}), "0 of compiled modules"),
    ):
        bill.write_text(content, encoding="utf-8")
        with pytest.raises(release_check.CheckError, match=message):
            release_check.materials(bill, wheel)


def test_a_program_that_is_missing_is_named(clone):
    with pytest.raises(release_check.CheckError, match="no-such-program: "):
        release_check.run("no-such-program")


def test_a_crate_without_a_licence_is_named():
    with pytest.raises(release_check.notices.NoticeError, match=r"some 1\.0 names no licence"):
        release_check.notices.chosen({"name": "some", "version": "1.0", "license": None})
