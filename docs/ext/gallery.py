"""Pages of the gallery: an example's picture, what it prints, and its source, one page each.

Made from `examples/` and what `make gallery` kept in docs/gallery, so that a page cannot say
anything that its example does not do.
"""

import ast
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
EXAMPLES, GALLERY = DOCS.parent / "examples", DOCS / "gallery"
SOURCE = "../../examples"


def title(example):
    """The first sentence of its docstring."""
    text = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or example.stem
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def short(example):
    """Its name in the sidebar."""
    return example.stem.replace("_", " ")


def about(example):
    """The rest of its docstring."""
    text = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or ""
    return "\n\n".join(text.split("\n\n")[1:])


def page(example):
    """A page as MyST."""
    parts = [f"# {example.stem[:2]}: {title(example)}", about(example)]
    if (GALLERY / f"{example.stem}.html").exists():
        parts.append(
            "```{raw} html\n"
            f'<iframe src="../_static/replays/{example.stem}.html" title="{example.stem}" '
            'loading="lazy" style="width: 100%; height: 420px; border: 1px solid #8885"></iframe>\n'
            "```\n\nDrag to turn it, the wheel zooms. The arrow is the force of the hand."
        )
    elif (GALLERY / f"{example.stem}.jpg").exists():
        parts.append(f"![what the arm does]({example.stem}.jpg)")
    parts += [
        "It prints:",
        f"```{{literalinclude}} {example.stem}.txt\n:language: text\n:lines: 2-\n```",
        f"```{{literalinclude}} {SOURCE}/{example.name}\n:language: python\n```",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def index(examples):
    """The page that shows all of them."""
    rows = []
    for example in examples:
        picture = GALLERY / f"{example.stem}.jpg"
        shown = f"[![]({picture.name})]({example.stem}.md)" if picture.exists() else ""
        link = f"**[{example.stem[:2]}]({example.stem}.md)** {title(example)}"
        rows.append(f"| {link} | {shown} |")
    pages = "\n".join(f"{short(example)} <{example.stem}>" for example in examples)
    return (
        "# Gallery\n\n"
        "The examples in order are the tutorial. Each runs as it stands on the simulated arm: "
        "`.venv/bin/python examples/01_soft_sideways.py` after `make demo`. Pictures and texts "
        "were made by running them (`make gallery`); a test notices when one has changed since."
        "\n\n"
        "| example | what the arm does |\n|---|---|\n" + "\n".join(rows) + "\n\n"
        f"```{{toctree}}\n:hidden:\n\n{pages}\n```\n"
    )


def write(app):
    """Write what changed, so that pages that did not are not built again."""
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
    """Sphinx calls it."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
