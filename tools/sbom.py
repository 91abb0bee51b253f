"""Write the software bill of materials of a release: CycloneDX 1.6, beside the wheels.

    python tools/sbom.py build/wheels-all

It lists the crates that the compiled module links, with their checksums and the licence under which
they are used. It has no time and no serial number, so the same commit gives the same bytes. maturin
would write one into each wheel, with the builder's folder in it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import notices


def purl(crate: dict[str, Any]) -> str:
    """Return the package URL of a crate."""
    return f"pkg:cargo/{crate['name']}@{crate['version']}"


def bill() -> dict[str, Any]:
    """Return the bill of materials."""
    lock = tomllib.loads((notices.ROOT / "Cargo.lock").read_text(encoding="utf-8"))
    checksums = {(p["name"], p["version"]): p.get("checksum") for p in lock["package"]}
    (version,) = [p["version"] for p in lock["package"] if p["name"] == notices.ROOT_CRATE]
    components = [
        {
            "type": "library",
            "bom-ref": purl(crate),
            "name": crate["name"],
            "version": crate["version"],
            "hashes": [
                {"alg": "SHA-256", "content": checksums[crate["name"], crate["version"]]},
            ],
            "licenses": [{"expression": notices.chosen(crate)}],
            "purl": purl(crate),
        }
        for crate in notices.linked_crate_names()
    ]
    compiler = subprocess.run(["rustc", "--version"], capture_output=True, text=True, check=True)
    standard_library = {
        "type": "library",
        "bom-ref": "rust-std",
        "name": "Rust standard library",
        "version": compiler.stdout.split()[1],
        "licenses": [{"expression": "Apache-2.0"}],
    }
    components.append(standard_library)
    root = f"pkg:pypi/pliant@{version}"
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "library",
                "bom-ref": root,
                "name": "pliant",
                "version": version,
                "licenses": [{"expression": "Apache-2.0"}],
                "purl": root,
            },
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": [part["bom-ref"] for part in components]}],
    }


if __name__ == "__main__":
    made = bill()
    name = f"pliant-{made['metadata']['component']['version']}.cdx.json"
    text = json.dumps(made, indent=2, ensure_ascii=False) + "\n"
    (Path(sys.argv[1]) / name).write_text(text, encoding="utf-8")
