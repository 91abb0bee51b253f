"""Recompresses wheels in place with zopfli: smaller downloads, same contents.

    python tools/recompress_wheel.py build/wheels/*.whl

An installer reads the result like any wheel: the method is still deflate. Entries keep their order,
time and permissions, so the same wheel gives the same bytes.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import zopfli


def recompress(wheel: Path) -> None:
    """Replace `wheel` by the recompressed one."""
    temporary = wheel.with_suffix(".tmp")
    with (
        zipfile.ZipFile(wheel) as source,
        # The default of 15 blocks is too few for the module: 5 kB more.
        zopfli.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, block_splitting_max=0) as target,
    ):
        for entry in source.infolist():
            target.writestr(entry, source.read(entry))
    temporary.replace(wheel)


if __name__ == "__main__":
    for path in sys.argv[1:]:
        recompress(Path(path))
