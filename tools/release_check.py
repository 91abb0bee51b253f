"""Rehearse a release: everything but the upload. `make release-check` runs it.

    python tools/release_check.py [TARGET...]

The program takes the last commit, not the files of the work tree, builds it in two folders, once
with another time zone and file mode mask, and compares the archives byte by byte. It checks
archives, bill of materials, licences, pins, versions and tag, installs the wheel and the source
distribution into fresh environments, and runs the README's first program. TARGET: Rust targets
whose wheels are built, by default Linux x86-64. Needs a network for the packages.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import notices

ROOT = notices.ROOT
WORK = ROOT / "build" / "release-check"
TOOLS = ROOT / "build" / "wheel-tools"
HOST = "x86_64-unknown-linux-gnu"
T = TypeVar("T")


class CheckError(Exception):
    """A check that failed, with the reason."""


def run(
    *command: str | Path,
    cwd: Path = ROOT,
    env: Mapping[str, str] | None = None,
    umask: int = -1,
) -> str:
    """Run a command and return its output; it is shown only if the command fails."""
    try:
        result = subprocess.run(
            [str(part) for part in command],
            cwd=cwd,
            env={**os.environ, **(env or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            umask=umask,
            check=False,
        )
    except OSError as error:
        raise CheckError(f"{command[0]}: {error}") from error
    if result.returncode:
        raise CheckError(
            f"{' '.join(map(str, command))}: exit {result.returncode}\n{result.stdout}"
        )
    return result.stdout


def text_of(path: Path) -> str:
    """Return the text of a file."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise CheckError(f"{path}: {error}") from error


def entry(data: Any, file: str | Path, *keys: str) -> Any:
    """Return the entry of nested tables under `keys`; `file` is named in the error."""
    for i, key in enumerate(keys, 1):
        if not isinstance(data, Mapping) or key not in data:
            raise CheckError(f"{file}: no entry {'.'.join(keys[:i])}")
        data = data[key]
    return data


def toml_entry(path: str, *keys: str) -> Any:
    """Return an entry of a TOML file; `path` is relative to the root of the repository."""
    try:
        data = tomllib.loads(text_of(ROOT / path))
    except tomllib.TOMLDecodeError as error:
        raise CheckError(f"{path}: {error}") from error
    return entry(data, path, *keys)


def single(items: Sequence[T], description: str) -> T:
    """Return the only element of a list; an error contains its `description`."""
    if len(items) != 1:
        raise CheckError(f"{len(items)} of {description}, 1 is needed: {list(items)}")
    return items[0]


def members(wheel: Path) -> dict[str, bytes]:
    """Return the files of a wheel by name."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile) as error:
        raise CheckError(f"{wheel}: {error}") from error


@contextmanager
def second_folder() -> Iterator[Path]:
    """Yield a folder outside of the clone, in memory where the system has such a place."""
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Path(folder) / "elsewhere" / "pliant"


def export(commit: str, folder: Path, umask: int) -> None:
    """Write the files of a commit into a new folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    archive = folder / "commit.tar"
    run("git", "archive", "--output", archive, commit)
    run("tar", "--no-same-permissions", "-xf", archive, "-C", folder, umask=umask)
    archive.unlink()


def build(commit: str, folder: Path, targets: list[str], zone: str, umask: int) -> dict[str, Path]:
    """Export a commit, build archives and bill of materials there; return them by name."""
    export(commit, folder, umask)
    epoch = run("git", "log", "-1", "--format=%ct", commit).strip()
    env = {"SOURCE_DATE_EPOCH": epoch, "WHEEL_TOOLS": str(TOOLS), "TZ": zone}
    run("sh", "tools/wheels.sh", sys.executable, *targets, cwd=folder, env=env, umask=umask)
    out = folder / "build" / "wheels-all"
    kinds = ("*/*.whl", "*.tar.gz", "*.cdx.json")
    return {path.name: path for kind in kinds for path in sorted(out.glob(kind))}


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def versions() -> str:
    """Compare the version in all places; return it."""
    version = toml_entry("Cargo.toml", "workspace", "package", "version")
    heading = first_heading()
    cited = re.search(r"^version: (\S+)$", text_of(ROOT / "CITATION.cff"), re.MULTILINE)
    stated = {
        "dependency on pliant-core": toml_entry(
            "Cargo.toml", "workspace", "dependencies", "pliant-core", "version"
        ),
        "CITATION.cff": cited and cited[1],
        "first heading of CHANGELOG.md": heading[0],
    }
    for lock in ("Cargo.lock", "fuzz/Cargo.lock"):
        for crate in toml_entry(lock, "package"):
            name = entry(crate, lock, "name")
            if name.startswith("pliant-") and name != "pliant-fuzz":
                stated[f"{name} in {lock}"] = entry(crate, f"{lock}: {name}", "version")
    for path in sorted(ROOT.glob("integrations/*/pyproject.toml")):
        file = path.relative_to(ROOT).as_posix()
        stated[file] = toml_entry(file, "project", "version")
    differences = [
        f"{file} has {stated_version}"
        for file, stated_version in stated.items()
        if stated_version != version
    ]
    if differences:
        raise CheckError(f"Cargo.toml has version {version}, but {', '.join(differences)}")
    return f"{version} in {len(stated) + 1} places"


def first_heading() -> tuple[str, str]:
    """Return version and date, or the text in place of the date, that head CHANGELOG.md."""
    heading = re.search(r"^## \[([^]]+)\] - (.+)$", text_of(ROOT / "CHANGELOG.md"), re.MULTILINE)
    if heading is None:
        raise CheckError("CHANGELOG.md: no heading such as '## [0.1.0] - 2026-01-31'")
    return heading[1], heading[2].strip()


def tag(commit: str) -> str:
    """Compare the tags of the commit with the version; a tagged changelog needs a date."""
    expected = f"v{toml_entry('Cargo.toml', 'workspace', 'package', 'version')}"
    tags = set(run("git", "tag", "--points-at", commit).split())
    if os.environ.get("GITHUB_REF_TYPE") == "tag":
        tags.add(os.environ.get("GITHUB_REF_NAME", ""))
    releases = sorted(name for name in tags if name.startswith("v"))
    date = first_heading()[1]
    is_dated = re.fullmatch(r"\d{4}-\d\d-\d\d", date) is not None
    if not releases:
        missing = "" if is_dated else f"; CHANGELOG.md says {date!r}: date it before the tag"
        return f"no tag yet, {expected} is the one to set{missing}"
    if releases != [expected]:
        raise CheckError(f"the commit has the tag {', '.join(releases)}, its version is {expected}")
    if not is_dated:
        raise CheckError(
            f"the commit has the tag {expected}, but CHANGELOG.md has no date: {date!r}"
        )
    return f"{expected} is the version, of {date}"


def pins() -> str:
    """Check that everything that a build takes from outside is pinned."""
    missing, actions = [], 0
    for path in sorted((ROOT / ".github" / "workflows").glob("*.yml")):
        text = text_of(path)
        for action in re.findall(r"uses: (\S+)", text):
            actions += 1
            if not re.search(r"@[0-9a-f]{40}$", action):
                missing.append(f"{path.name}: {action} is not pinned to a commit")
        for names in re.findall(r"cargo install (.+)", text):
            crates = [name for name in names.split() if not name.startswith("-")]
            missing += [f"{path.name}: {name} has no version" for name in crates if "@" not in name]
    run("cargo", "metadata", "--locked", "--format-version", "1")
    foreign = [crate for crate in toml_entry("Cargo.lock", "package") if "source" in crate]
    missing += [
        f"{entry(crate, 'Cargo.lock', 'name')} has no checksum"
        for crate in foreign
        if "checksum" not in crate
    ]
    match = re.search(r"pip install --quiet (.+)", text_of(ROOT / "tools" / "wheels.sh"))
    if match is None:
        raise CheckError("tools/wheels.sh: no 'pip install --quiet' of the tools of a build")
    tools = match[1].split()
    missing += [f"tools/wheels.sh: {tool} is not pinned" for tool in tools if "==" not in tool]
    if missing:
        raise CheckError("; ".join(missing))
    return f"{len(foreign)} crates with checksums, {actions} actions at commits, {len(tools)} tools"


def licences() -> str:
    """Compare THIRD_PARTY_LICENSES with the crates that are linked, and ask cargo-deny."""
    try:
        expected = notices.notices()
    except notices.NoticeError as error:
        raise CheckError(str(error)) from error
    if text_of(ROOT / "THIRD_PARTY_LICENSES") != expected:
        raise CheckError("THIRD_PARTY_LICENSES is not of the crates of Cargo.lock: make notices")
    if shutil.which("cargo-deny") is None:
        return "notices are of the crates that are linked; NOT CHECKED: cargo-deny is not installed"
    run("cargo", "deny", "--workspace", "check", "bans", "licenses", "sources")
    try:
        run("cargo", "deny", "--workspace", "check", "advisories")
    except CheckError as error:
        if "failed to fetch" not in str(error):
            raise
        return (
            "notices and cargo-deny agree; NOT CHECKED: advisories, their database is out of reach"
        )
    return "notices, cargo-deny and its advisories agree"


def contents(wheel: Path) -> str:
    """Check names, licences and the folders that the binary names."""
    data = members(wheel)
    for licence in ("LICENSE", "THIRD_PARTY_LICENSES"):
        end = f".dist-info/licenses/{licence}"
        name = single([name for name in data if name.endswith(end)], f"{end} in {wheel.name}")
        if data[name] != (ROOT / licence).read_bytes():
            raise CheckError(f"{name} is not {licence}")
    foreign = [name for name in data if name.partition("/")[0].partition("-")[0] != "pliant"]
    if foreign:
        raise CheckError(f"the wheel brings files beside pliant: {foreign}")
    folders = [str(Path.home()) + "/", str(ROOT)]
    findings = [f"{name} names {f}" for name in data for f in folders if f.encode() in data[name]]
    if findings:
        raise CheckError("; ".join(findings))
    return (
        f"{len(data)} files, {wheel.stat().st_size} bytes, both licences, no folder of the builder"
    )


def materials(bill: Path, wheel: Path) -> str:
    """Validate the bill of materials, and compare it with the crates that the module names."""
    code = (
        "import sys; from pathlib import Path; from cyclonedx.schema import SchemaVersion;"
        "from cyclonedx.validation.json import JsonStrictValidator as V;"
        "error = V(SchemaVersion.V1_6).validate_str(Path(sys.argv[1]).read_text());"
        "sys.exit(str(error) if error else 0)"
    )
    run(TOOLS / "bin" / "python", "-c", code, bill)
    try:
        content = json.loads(text_of(bill))
    except json.JSONDecodeError as error:
        raise CheckError(f"{bill.name}: {error}") from error
    components = entry(content, bill.name, "components")
    names = {entry(component, bill.name, "name") for component in components}
    data = members(wheel)
    modules = [name for name in data if "/_core." in name and name.endswith(("so", "pyd"))]
    binary = data[single(modules, f"compiled modules in {wheel.name}")]
    # Panic messages name the sources of the crates that can panic.
    files = {
        m[1].decode()
        for m in re.finditer(rb"index\.crates\.io-[0-9a-f]+/([\w-]+?)-\d+\.\d+\.\d+", binary)
    }
    if missing := sorted(files - names):
        raise CheckError(f"the module has code of {missing}, which {bill.name} does not list")
    return f"valid CycloneDX 1.6, {len(names)} components, all {len(files)} that the module names"


def installs(archive: Path, folder: Path) -> str:
    """Install an archive into a fresh environment, and run the README's first program there."""
    shutil.rmtree(folder, ignore_errors=True)
    run(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", f"{archive}[sim]")
    program = re.search(r"^```python\n(.*?)^```", text_of(ROOT / "README.md"), re.M | re.S)
    if program is None:
        raise CheckError("README.md: no Python program")
    (folder / "first.py").write_text(program[1], encoding="utf-8")
    env = {"PYTHONPATH": "", "PYTHONSAFEPATH": "1", "MUJOCO_GL": "egl"}
    run(python, "first.py", cwd=folder, env=env)
    output = run(
        python,
        "-c",
        "import pliant; print(pliant.__version__, pliant.__file__)",
        cwd=folder,
        env=env,
    )
    if str(folder) not in output:
        raise CheckError(f"not the installed package: {output}")
    run(folder / "venv" / "bin" / "pliant", "--help", cwd=folder, env=env)
    return f"version {output.split()[0]}; the README's program and `pliant --help` run"


def main(targets: list[str]) -> int:
    """Run all checks; return 1 if one failed."""
    failed = 0
    results = []

    def check(name: str, action: Callable[[], str]) -> None:
        nonlocal failed
        print(f"\n== {name}", flush=True)
        try:
            text = action()
        except CheckError as error:
            failed, text = failed + 1, f"FAILED: {error}"
        print(text, flush=True)
        results.append(f"{name}: {text.splitlines()[0]}")

    commit = run("git", "rev-parse", "HEAD").strip()
    print(f"rehearses {commit}")
    if status := run("git", "status", "--porcelain"):
        print(f"!! not committed, and so not rehearsed:\n{status}")
    check("version", versions)
    check("tag", lambda: tag(commit))
    check("pins", pins)
    check("licences", licences)
    builds: list[dict[str, Path]] = []

    def build_twice() -> str:
        builds.append(build(commit, WORK / "first", targets, "UTC", 0o022))
        with second_folder() as second:
            other = build(commit, second, targets, "Asia/Kolkata", 0o077)
            if builds[0].keys() != other.keys():
                raise CheckError(f"builds made {sorted(builds[0])} and {sorted(other)}")
            hashes = {name: [digest(path), digest(other[name])] for name, path in builds[0].items()}
        for name, (first, two) in hashes.items():
            print(f"{first}  {name}\n{two}  {'same' if first == two else 'DIFFERENT'}")
        if different := [name for name, (first, two) in hashes.items() if first != two]:
            raise CheckError(f"two builds differ: {different}")
        return f"{len(hashes)} files are the same bytes (twine and abi3audit passed on both)"

    check("two builds in two folders", build_twice)
    if builds:
        wheels = [path for name, path in builds[0].items() if name.endswith(".whl")]

        def ending(end: str) -> Path:
            return single([path for name, path in builds[0].items() if name.endswith(end)], end)

        for wheel in wheels:
            check(f"contents of {wheel.name}", lambda wheel=wheel: contents(wheel))
        here = [wheel for wheel in wheels if HOST in str(wheel)]
        for wheel in here:
            check("bill of materials", lambda wheel=wheel: materials(ending(".json"), wheel))
            check(
                "wheel in a fresh environment", lambda wheel=wheel: installs(wheel, WORK / "wheel")
            )
        check(
            "source distribution in a fresh environment",
            lambda: installs(ending(".tar.gz"), WORK / "sdist"),
        )
    print("\n" + "\n".join(results))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or [HOST]))
