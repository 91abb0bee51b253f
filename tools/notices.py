"""Write THIRD_PARTY_LICENSES: the crates that the compiled module links, and their notices.

`make notices` runs it. A crate available under Apache-2.0 is used under it, and needs no text
beside LICENSE; the text of every other licence is copied from the crate.
"""

import json
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "THIRD_PARTY_LICENSES"
ROOT_CRATE = "pliant-py"
HEAD = """The compiled module of pliant links the crates below. Those marked Apache-2.0 are used
under that licence, whose text is in LICENSE. The licences of the others follow the list. Rust's
standard library is used under Apache-2.0.

"""


class NoticeError(SystemExit):
    """The crates cannot be listed, or one has no licence or no licence text."""


def linked_crate_names() -> list[dict]:
    """Return crates linked on Linux, by name and version, without ours and build tools."""
    command = (
        "cargo metadata --format-version 1 --locked --filter-platform x86_64-unknown-linux-gnu"
    )
    try:
        result = subprocess.run(
            command.split(), cwd=ROOT, capture_output=True, text=True, check=True
        )
    except OSError as error:
        raise NoticeError(f"{command}: {error}") from error
    except subprocess.CalledProcessError as error:
        raise NoticeError(f"{command}: exit {error.returncode}\n{error.stderr}") from error
    data = json.loads(result.stdout)
    crates = {crate["id"]: crate for crate in data["packages"]}
    nodes = {node["id"]: node for node in data["resolve"]["nodes"]}
    remaining = [name for name, crate in crates.items() if crate["name"] == ROOT_CRATE]
    linked_crates = {}
    while remaining:
        name = remaining.pop()
        is_macro = any("proc-macro" in target["kind"] for target in crates[name]["targets"])
        if name in linked_crates or is_macro:
            continue
        linked_crates[name] = crates[name]
        remaining += [
            dependency["pkg"]
            for dependency in nodes[name]["deps"]
            if any(kind["kind"] is None for kind in dependency["dep_kinds"])
        ]
    foreign = [crate for crate in linked_crates.values() if crate["source"] is not None]
    return sorted(foreign, key=lambda crate: (crate["name"], crate["version"]))


def chosen(crate: dict) -> str:
    """Return the licence under which we use a crate."""
    licence = crate.get("license")
    if not licence:
        raise NoticeError(f"{crate['name']} {crate['version']} names no licence")
    offered = re.split(r" OR |/", licence)
    return next((name for name in ("Apache-2.0", "MIT") if name in offered), licence)


def text(crate: dict, licence: str) -> str:
    """Return the text of a licence in the crate."""
    folder = Path(crate["manifest_path"]).parent
    for name in (
        f"LICENSE-{licence}",
        f"LICENSE-{licence}.md",
        "LICENSE",
        "LICENSE.md",
        "LICENSE.txt",
        "COPYING",
    ):
        if (folder / name).is_file():
            return (folder / name).read_text(encoding="utf-8").strip()
    raise NoticeError(f"{crate['name']} {crate['version']} has no text of {licence}")


def notices() -> str:
    """Return the text of THIRD_PARTY_LICENSES."""
    crates = linked_crate_names()
    out = HEAD + "".join(f"{c['name']} {c['version']}: {chosen(c)}\n" for c in crates)
    for crate in crates:
        licence = chosen(crate)
        if licence != "Apache-2.0":
            out += f"\n{'-' * 80}\n{crate['name']} {crate['version']}, {licence}\n\n"
            out += text(crate, licence) + "\n"
    return out


if __name__ == "__main__":
    FILE.write_text(notices(), encoding="utf-8")
