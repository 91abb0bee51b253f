"""Run the examples and store their output and the motion of their arm: text, film strip, replay.

    make gallery                          # changed ones; all of them with ARGS=--all
    .venv/bin/python tools/gallery.py 07  # one of them

Results are in docs/gallery: `NAME.txt` with the digest of its example, `NAME.jpg`, and for some
`NAME.html`, a self-contained replay. tests/test_house.py detects a changed example by the digest,
and a changed law by running the quick examples again. docs/ext/gallery.py makes the pages.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# The modules that draw the pictures are in the clone but not in the installed package.
sys.path.insert(0, str(ROOT))
EXAMPLES, GALLERY = ROOT / "examples", ROOT / "docs" / "gallery"
#: Examples whose page has a replay: a file of about 100 KB each.
REPLAYED = ("01", "07")
#: Time between two frames of a replay [s], largest number of its frames, and frames of a strip.
PERIOD, MAX_FRAMES, STRIP_FRAMES = 0.05, 240, 4
#: Timeout of an example [s].
LONGEST = 600.0


def digest(example: Path) -> str:
    """Return the digest of an example."""
    return hashlib.sha256(example.read_bytes()).hexdigest()[:16]


def stored_digest(example: Path) -> str | None:
    """Return the digest of the example at its last run."""
    text = GALLERY / f"{example.stem}.txt"
    return text.read_text(encoding="utf-8").split("\n", 1)[0] if text.exists() else None


def record(example: Path) -> None:
    """Run an example in a process of its own and store its output."""
    result = subprocess.run(
        [sys.executable, __file__, "--watch", str(example)],
        cwd=ROOT,
        env={**os.environ, "MUJOCO_GL": "egl", "MPLBACKEND": "Agg", "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    if result.returncode != 0:
        raise SystemExit(f"{example.name} failed:\n{result.stderr}")
    # Names of temporary folders differ between runs.
    output = re.sub(r"/tmp/\w+", "/tmp", result.stdout)
    text = f"{digest(example)}\n{output.rstrip()}\n"
    (GALLERY / f"{example.stem}.txt").write_text(text, encoding="utf-8")


def watch(example: Path) -> None:
    """Run an example and record its simulated arm; store pictures of the longest motion."""
    try:
        from pliant.sim import Plant
    except ImportError:
        Plant = None  # type: ignore[assignment, misc]
    films: dict[int, Film] = {}
    if Plant is not None:
        advance = Plant.advance

        def seen(plant: Plant, n_steps: int | None = None) -> None:
            advance(plant, n_steps)
            films.setdefault(id(plant), Film(plant)).look()

        Plant.advance = seen  # type: ignore[method-assign]
    runpy.run_path(str(example), run_name="__main__")
    film = max(films.values(), key=lambda film: film.moved(), default=None)
    if film is not None and film.moved() > 0.0:
        film.strip(GALLERY / f"{example.stem}.jpg")
        if example.stem[:2] in REPLAYED:
            film.replay(GALLERY / f"{example.stem}.html", example.stem)


class Film:
    """Record of one simulated arm."""

    def __init__(self, plant: object) -> None:
        """Start the record; a reset of the simulated arm restarts it."""
        self.plant = plant
        self.frames: list[dict[str, object]] = []

    def look(self) -> None:
        """Record a frame if it is due."""
        plant = self.plant
        if self.frames and plant.time < self.frames[-1]["time"]:
            self.frames.clear()
        if self.frames and plant.time - self.frames[-1]["time"] < PERIOD - 1e-9:
            return
        data = plant.mj_data
        self.frames.append(
            {
                "time": plant.time,
                "qpos": data.qpos.copy(),
                "mocap": (data.mocap_pos.copy(), data.mocap_quat.copy()),
                "q": plant.q.copy(),
                "tool": plant.tool[:3, 3].copy(),
                "hands": [
                    (hand.hand.force(plant.ground_truth, plant.time)[2].copy(), hand.force.copy())
                    for hand in plant.hands
                ],
            }
        )

    def moved(self) -> float:
        """Return the path length of the tool [m]."""
        import numpy as np

        tools = np.array([frame["tool"] for frame in self.frames]).reshape(-1, 3)
        return float(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())

    def telling(self, count: int) -> list[dict[str, object]]:
        """Return frames after equal shares of the motion; periods at rest are left out."""
        import numpy as np

        steps = np.abs(np.diff([frame["q"] for frame in self.frames], axis=0)).sum(axis=1)
        path_length = np.concatenate([[0.0], np.cumsum(steps)])
        indices = np.searchsorted(
            path_length,
            np.linspace(0.0, path_length[-1], count + 1)[1:] - 0.5 * path_length[-1] / count,
        )
        return [self.frames[min(int(index), len(self.frames) - 1)] for index in indices]

    def show(self, frame: dict[str, object]) -> None:
        """Set the simulated arm to the state of a frame."""
        data = self.plant.mj_data
        data.qpos[:] = frame["qpos"]
        data.mocap_pos[:], data.mocap_quat[:] = frame["mocap"]

    def strip(self, path: Path) -> None:
        """Write the frames side by side into one picture."""
        import numpy as np
        from PIL import Image

        from experiments.pictures import Studio

        centre, size = self.scene()
        with Studio(self.plant, size=(330, 280), look_at=centre, distance=1.45 * size) as studio:
            pictures = []
            for frame in self.telling(STRIP_FRAMES):
                self.show(frame)
                pixels = studio.picture(frame["q"]).astype(float)
                cover = pixels[:, :, 3:] / 255.0
                pictures.append(cover * pixels[:, :, :3] + (1.0 - cover) * 255.0)
        picture = Image.fromarray(np.concatenate(pictures, axis=1).astype(np.uint8))
        picture.save(path, quality=82, optimize=True)

    def scene(self) -> tuple[list[float], float]:
        """Return the middle of everything during the motion, and its extent [m]."""
        import mujoco
        import numpy as np

        model, data = self.plant.mj_model, self.plant.mj_data
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for frame in self.telling(STRIP_FRAMES):
            self.show(frame)
            mujoco.mj_kinematics(model, data)
            solid = model.geom_rbound > 0.0  # a plane has no size
            positions, sizes = data.geom_xpos[solid], 0.6 * model.geom_rbound[solid, None]
            low = np.minimum(low, (positions - sizes).min(axis=0))
            high = np.maximum(high, (positions + sizes).max(axis=0))
        return ((low + high) / 2.0).tolist(), float(np.linalg.norm(high - low))

    def replay(self, path: Path, title: str) -> None:
        """Write a page that plays the motion: primitive shapes, and their poses in each frame."""
        import mujoco
        import numpy as np

        from experiments.pictures import furnish

        spec = self.plant.spec.copy()
        furnish(spec, self.plant, handle=False)
        model = spec.compile()
        data = mujoco.MjData(model)
        kinds = {2: "ball", 3: "capsule", 5: "cylinder", 6: "box"}
        shapes = [
            {
                "kind": kinds[int(model.geom_type[g])],
                "body": int(model.geom_bodyid[g]),
                "size": np.round(model.geom_size[g], 4).tolist(),
                "at": np.round(model.geom_pos[g], 4).tolist(),
                "quat": np.round(model.geom_quat[g], 4).tolist(),
                "rgba": np.round(model.geom_rgba[g], 2).tolist(),
            }
            for g in range(model.ngeom)
            if int(model.geom_type[g]) in kinds and model.geom_rgba[g][3] > 0.0
        ]
        step = max(1, -(-len(self.frames) // MAX_FRAMES))
        frames, forces = [], []
        for frame in self.frames[::step]:
            data.qpos[:] = frame["qpos"]
            data.mocap_pos[:], data.mocap_quat[:] = frame["mocap"]
            mujoco.mj_kinematics(model, data)
            frames.append(np.round(np.hstack([data.xpos, data.xquat]), 4).reshape(-1).tolist())
            forces.append([[*np.round(p, 3), *np.round(f, 2)] for p, f in frame["hands"]])
        centre, size = self.scene()
        film = {
            "step": PERIOD * step,
            "shapes": shapes,
            "frames": frames,
            "forces": forces,
            "centre": np.round(centre, 3).tolist(),
            "size": round(size, 3),
        }
        template = (ROOT / "tools" / "replay.html").read_text(encoding="utf-8")
        page = template.replace("@TITLE@", title).replace("@FILM@", json.dumps(film))
        path.write_text(page, encoding="utf-8")


def main() -> None:
    """Run the requested examples, or the changed ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("numbers", nargs="*", help="examples by number, e.g. 07")
    parser.add_argument("--all", action="store_true", help="also those that did not change")
    parser.add_argument("--watch", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.watch is not None:
        watch(options.watch)
        return
    GALLERY.mkdir(exist_ok=True)
    for old in GALLERY.iterdir():
        if old.suffix in {".txt", ".jpg", ".html"} and not (EXAMPLES / f"{old.stem}.py").exists():
            old.unlink()
    for example in sorted(EXAMPLES.glob("*.py")):
        is_named = example.stem[:2] in options.numbers
        is_changed = not options.numbers and (
            options.all or stored_digest(example) != digest(example)
        )
        if is_named or is_changed:
            print(example.name, flush=True)
            record(example)


if __name__ == "__main__":
    main()
