"""Pages of the gallery: picture, output and source of each example.

Inputs are `examples/` and the files that `make gallery` stored in docs/gallery.
"""

import ast
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
EXAMPLES, GALLERY = DOCS.parent / "examples", DOCS / "gallery"
SOURCE = "../../examples"


def title(example):
    """Return the first paragraph of the docstring."""
    text = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or example.stem
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def short(example):
    """Return the name in the sidebar."""
    return example.stem.replace("_", " ")


def about(example):
    """Return the docstring after its first paragraph."""
    text = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or ""
    return "\n\n".join(text.split("\n\n")[1:])


def page(example):
    """Return an example's page as MyST."""
    parts = [f"# {example.stem[:2]}: {title(example)}", about(example)]
    if (GALLERY / f"{example.stem}.html").exists():
        parts.append(
            "```{raw} html\n"
            f'<iframe src="../_static/replays/{example.stem}.html" title="{example.stem}" '
            'loading="lazy" style="width: 100%; height: 420px; border: 1px solid #8885"></iframe>\n'
            "```\n\nDrag to turn it, use the wheel to zoom. The arrow is the force of the hand."
        )
    elif (GALLERY / f"{example.stem}.jpg").exists():
        parts.append(f"![the motion of the arm]({example.stem}.jpg)")
    parts += [
        "Output:",
        f"```{{literalinclude}} {example.stem}.txt\n:language: text\n:lines: 2-\n```",
        f"```{{literalinclude}} {SOURCE}/{example.name}\n:language: python\n```",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def index(examples):
    """Return the index page."""
    rows = []
    for example in examples:
        picture = GALLERY / f"{example.stem}.jpg"
        shown = f"[![]({picture.name})]({example.stem}.md)" if picture.exists() else ""
        link = f"**[{example.stem[:2]}]({example.stem}.md)** {title(example)}"
        rows.append(f"| {link} | {shown} |")
    pages = "\n".join(f"{short(example)} <{example.stem}>" for example in examples)
    return (
        "# Gallery\n\n"
        "The numbered examples are the tutorial. Each runs unchanged on the simulated arm: "
        "`.venv/bin/python examples/01_soft_sideways.py` after `make demo`. `make gallery` runs "
        "them and stores pictures and output; a test fails when an example has changed since."
        "\n\n"
        "| example | motion |\n|---|---|\n" + "\n".join(rows) + "\n\n"
        f"```{{toctree}}\n:hidden:\n\n{pages}\n```\n"
    )


def write(app):
    """Write the changed pages only, so that Sphinx does not rebuild the others."""
    examples = sorted(EXAMPLES.glob("*.py"))
    texts = {f"{example.stem}.md": page(example) for example in examples}
    texts["index.md"] = index(examples)
    for name, text in texts.items():
        file = GALLERY / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
    for old in GALLERY.glob("*.md"):
        if old.name not in texts:
            old.unlink()
    for replay in GALLERY.glob("*.html"):
        target = Path(app.outdir) / "_static" / "replays" / replay.name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(replay.read_bytes())


def setup(app):
    """Connect to Sphinx."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
