"""Rehearse a release: everything but the upload. `make release-check` runs it.

    python tools/release_check.py [TARGET...]

Takes the last commit, not the files of the work tree. Builds it in two folders, once with another
time zone and file mode mask, and compares the archives byte by byte; checks archives, bill of
materials, licences, pins and versions; installs the wheel and the source distribution into fresh
environments, and runs the README's first program. TARGET: Rust targets whose wheels are built, by
default Linux x86-64. Needs a network for the packages.
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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import notices

ROOT = notices.ROOT
WORK = ROOT / "build" / "release-check"
TOOLS = ROOT / "build" / "wheel-tools"
HOST = "x86_64-unknown-linux-gnu"


class CheckError(Exception):
    """A check that failed, with the reason."""


def run(
    *command: str | Path,
    cwd: Path = ROOT,
    env: Mapping[str, str] | None = None,
    umask: int = -1,
) -> str:
    """Run a command and return its output; it is shown only if the command fails."""
    done = subprocess.run(
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
    if done.returncode:
        raise CheckError(f"{' '.join(map(str, command))}: exit {done.returncode}\n{done.stdout}")
    return done.stdout


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
    read = {
        path: (ROOT / path).read_text(encoding="utf-8") for path in ("CITATION.cff", "CHANGELOG.md")
    }
    workspace = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]
    version = workspace["package"]["version"]
    heading = re.search(r"^## \[([^]]+)\] - (.+)$", read["CHANGELOG.md"], re.MULTILINE)
    cited = re.search(r"^version: (\S+)$", read["CITATION.cff"], re.MULTILINE)
    told = {
        "dependency on pliant-core": workspace["dependencies"]["pliant-core"]["version"],
        "CITATION.cff": cited and cited[1],
        "first heading of CHANGELOG.md": heading and heading[1],
    }
    for lock in ("Cargo.lock", "fuzz/Cargo.lock"):
        crates = tomllib.loads((ROOT / lock).read_text(encoding="utf-8"))["package"]
        told |= {
            f"{c['name']} in {lock}": c["version"]
            for c in crates
            if c["name"].startswith("pliant-") and c["name"] != "pliant-fuzz"
        }
    for path in sorted(ROOT.glob("integrations/*/pyproject.toml")):
        told[str(path.relative_to(ROOT))] = tomllib.loads(path.read_text(encoding="utf-8"))[
            "project"
        ]["version"]
    wrong = [f"{place} has {found}" for place, found in told.items() if found != version]
    if wrong:
        raise CheckError(f"Cargo.toml has version {version}, but {', '.join(wrong)}")
    assert heading
    date = (
        "dated"
        if re.fullmatch(r"\d{4}-\d\d-\d\d", heading[2])
        else f"CHANGELOG.md says {heading[2]!r}: date it before the tag"
    )
    return f"{version} in {len(told) + 1} places; {date}"


def pins() -> str:
    """Check that everything that a build takes from outside is pinned."""
    wrong, actions = [], 0
    for path in sorted((ROOT / ".github" / "workflows").glob("*.yml")):
        for use in re.findall(r"uses: (\S+)", path.read_text(encoding="utf-8")):
            actions += 1
            if not re.search(r"@[0-9a-f]{40}$", use):
                wrong.append(f"{path.name}: {use} is not pinned to a commit")
    run("cargo", "metadata", "--locked", "--format-version", "1")
    crates = tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    foreign = [crate for crate in crates if "source" in crate]
    wrong += [f"{crate['name']} has no checksum" for crate in foreign if "checksum" not in crate]
    script = (ROOT / "tools" / "wheels.sh").read_text(encoding="utf-8")
    needed = re.search(r"pip install --quiet (.+)", script)
    tools = needed[1].split() if needed else []
    wrong += [f"tools/wheels.sh: {tool} is not pinned" for tool in tools if "==" not in tool]
    if wrong:
        raise CheckError("; ".join(wrong))
    return f"{len(foreign)} crates with checksums, {actions} actions at commits, {len(tools)} tools"


def licences() -> str:
    """Compare THIRD_PARTY_LICENSES with the crates that are linked, and ask cargo-deny."""
    if (ROOT / "THIRD_PARTY_LICENSES").read_text(encoding="utf-8") != notices.notices():
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
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
        data = {name: opened.read(name) for name in names}
    for licence in ("LICENSE", "THIRD_PARTY_LICENSES"):
        (name,) = [name for name in names if name.endswith(f".dist-info/licenses/{licence}")]
        if data[name] != (ROOT / licence).read_bytes():
            raise CheckError(f"{name} is not {licence}")
    foreign = [name for name in names if name.partition("/")[0].partition("-")[0] != "pliant"]
    if foreign:
        raise CheckError(f"the wheel brings files beside pliant: {foreign}")
    folders = [str(Path.home()) + "/", str(ROOT)]
    told = [f"{name} names {f}" for name in names for f in folders if f.encode() in data[name]]
    if told:
        raise CheckError("; ".join(told))
    return (
        f"{len(names)} files, {wheel.stat().st_size} bytes, both licences, no folder of the builder"
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
    listed = {c["name"] for c in json.loads(bill.read_text(encoding="utf-8"))["components"]}
    with zipfile.ZipFile(wheel) as opened:
        (module,) = [
            name for name in opened.namelist() if "/_core." in name and name.endswith(("so", "pyd"))
        ]
        binary = opened.read(module)
    # Panic messages name the sources of the crates that can panic.
    named = {
        m[1].decode()
        for m in re.finditer(rb"index\.crates\.io-[0-9a-f]+/([\w-]+?)-\d+\.\d+\.\d+", binary)
    }
    if missing := sorted(named - listed):
        raise CheckError(f"the module has code of {missing}, which {bill.name} does not list")
    return f"valid CycloneDX 1.6, {len(listed)} components, all {len(named)} that the module names"


def installs(archive: Path, folder: Path) -> str:
    """Install an archive into a fresh environment, and run the README's first program there."""
    shutil.rmtree(folder, ignore_errors=True)
    run(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", f"{archive}[sim]")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    program = readme.split("```python\n", 1)[1].split("```", 1)[0]
    (folder / "first.py").write_text(program, encoding="utf-8")
    env = {"PYTHONPATH": "", "PYTHONSAFEPATH": "1", "MUJOCO_GL": "egl"}
    run(python, "first.py", cwd=folder, env=env)
    shown = run(
        python,
        "-c",
        "import pliant; print(pliant.__version__, pliant.__file__)",
        cwd=folder,
        env=env,
    )
    if str(folder) not in shown:
        raise CheckError(f"not the installed package: {shown}")
    run(folder / "venv" / "bin" / "pliant", "--help", cwd=folder, env=env)
    return f"version {shown.split()[0]}; the README's program and `pliant --help` run"


def main(targets: list[str]) -> int:
    """Run all checks; return 1 if one failed."""
    failed = 0
    results = []

    def check(name: str, action: Callable[[], str]) -> None:
        nonlocal failed
        print(f"\n== {name}", flush=True)
        try:
            told = action()
        except CheckError as error:
            failed, told = failed + 1, f"FAILED: {error}"
        print(told, flush=True)
        results.append(f"{name}: {told.splitlines()[0]}")

    commit = run("git", "rev-parse", "HEAD").strip()
    print(f"rehearses {commit}")
    if changed := run("git", "status", "--porcelain"):
        print(f"!! not committed, and so not rehearsed:\n{changed}")
    check("version", versions)
    check("pins", pins)
    check("licences", licences)
    made: list[dict[str, Path]] = []

    def twice() -> str:
        made.append(build(commit, WORK / "first", targets, "UTC", 0o022))
        with second_folder() as second:
            other = build(commit, second, targets, "Asia/Kolkata", 0o077)
            hashes = {name: [digest(path), digest(other[name])] for name, path in made[0].items()}
        for name, (one, two) in hashes.items():
            print(f"{one}  {name}\n{two}  {'same' if one == two else 'DIFFERENT'}")
        if different := [name for name, (one, two) in hashes.items() if one != two]:
            raise CheckError(f"two builds differ: {different}")
        return f"{len(hashes)} files are the same bytes (twine and abi3audit passed on both)"

    check("two builds in two folders", twice)
    if made:
        wheels = [path for name, path in made[0].items() if name.endswith(".whl")]
        (archive,) = [path for name, path in made[0].items() if name.endswith(".tar.gz")]
        (bill,) = [path for name, path in made[0].items() if name.endswith(".json")]
        for wheel in wheels:
            check(f"contents of {wheel.name}", lambda wheel=wheel: contents(wheel))
        here = [wheel for wheel in wheels if HOST in str(wheel)]
        for wheel in here:
            check("bill of materials", lambda wheel=wheel: materials(bill, wheel))
            check(
                "wheel in a fresh environment", lambda wheel=wheel: installs(wheel, WORK / "wheel")
            )
        check(
            "source distribution in a fresh environment", lambda: installs(archive, WORK / "sdist")
        )
    print("\n" + "\n".join(results))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or [HOST]))
