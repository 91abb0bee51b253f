"""The API reference: autodoc over the package, signatures of the compiled part from its stub."""

import ast
import importlib
import inspect
import re
from pathlib import Path

from sphinx.errors import ExtensionError

import pliant

STUB = Path(__file__).resolve().parents[2] / "python" / "pliant" / "_core.pyi"
#: Constructor of a class in the stub.
NEW = "__new__"


def signatures():
    """Return the arguments of all classes and functions in the stub, by dotted name.

    Of several overloads, the first counts.
    """
    found = {}
    for item in ast.parse(STUB.read_text(encoding="utf-8")).body:
        inside = item.body if isinstance(item, ast.ClassDef) else [item]
        for member in inside:
            if isinstance(member, ast.FunctionDef):
                owner = item.name if isinstance(item, ast.ClassDef) else ""
                name = owner if member.name == NEW else f"{owner}.{member.name}".strip(".")
                found.setdefault(name, parts(member))
    return found


def parts(function):
    """Return the arguments of a function as text in brackets, without `self` and annotations."""
    arguments = function.args
    for listed in (arguments.posonlyargs, arguments.args):
        if listed and listed[0].arg in {"self", "cls"}:
            del listed[0]
            break
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        argument.annotation = None
    for rest in (arguments.vararg, arguments.kwarg):
        if rest is not None:
            rest.annotation = None
    return f"({ast.unparse(arguments)})"


KNOWN = signatures()

#: Pages of the package itself; a public name without a page fails the build.
CORE = {
    "robot": ("Model, poses and servos", "Model Pose Payload Servos"),
    "controller": ("Controller", "Controller Command"),
    "settings": (
        "Settings",
        "Settings Task Axis Tracking NullSpace Compensation TorqueLimits AXES",
    ),
    "contact": ("Contact", "ContactEstimator"),
    "loop": ("Arm and loop", "connect Arm Loop Tick HandGuiding"),
    "errors": (
        "Errors",
        "PliantError UrdfError FrameNotFoundError OutOfRangeError ShapeError ConfigError "
        "ServoError "
        "ServoTimeoutError ServoFaultError",
    ),
}
#: Modules with a page each, and their other public modules.
MODULES = {
    "functional": "The equations of the paper for a Jacobian of your own",
    "model": "Parts of a model, and results of inverse kinematics",
    "feasibility": "What an arm can exert in a pose or along a path",
    "types": "Results of a controller and of the contact estimator",
    "arm": "What an arm is, its states and its way down",
    "reactions": "Conditions on measured quantities, and actions",
    "robots": "Arms that ship with the package",
    "identify": "Servos, payload and delay from the arm itself",
    "teach": "Motions led by hand, and their replay",
    "teleop": "Following of a leader arm or a policy",
    "log": "Logs",
    "config": "Arms described in files",
    "servo": "Servos and their buses",
    "emulator": "Emulated servos on a serial port",
    "sim": "The simulated arm",
    "gym": "Gymnasium environments",
    "ros": "ROS 2 and Foxglove",
}


def entry(module, name):
    """Return the directive of one item."""
    thing = getattr(module, name)
    if inspect.isclass(thing):
        members = "" if issubclass(thing, Exception) else "\n   :members:"
        hidden = "\n   :exclude-members: model_config, model_post_init"
        return f".. autoclass:: {module.__name__}.{name}{members}{hidden if members else ''}\n"
    if callable(thing):
        return f".. autofunction:: {module.__name__}.{name}\n"
    return f".. py:data:: {module.__name__}.{name}\n   :type: {type(thing).__name__}\n"


def chapter(heading, module, names):
    """Return a page as MyST."""
    entries = "\n".join(entry(module, name) for name in names)
    return f"# {heading}\n\n```{{eval-rst}}\n{entries}```\n"


def public(module):
    """Return the names of the public items of a module."""
    own = getattr(module, "__all__", None) or [
        name
        for name, thing in vars(module).items()
        if inspect.isfunction(thing) and thing.__module__ == module.__name__
    ]
    return [name for name in own if not name.startswith("_")]


def known(thing, listed):
    """Return True if this very item already has a page."""
    return any(thing is other for other in listed)


def write(app):
    """Write the pages that have changed; fail if a public item has no page."""
    texts, listed = {}, []  # objects, since two modules may export the same one
    for key, (heading, names) in CORE.items():
        listed += [getattr(pliant, name) for name in names.split()]
        texts[f"{key}.md"] = chapter(heading, pliant, names.split())
    for name, heading in MODULES.items():
        module = importlib.import_module(f"pliant.{name}")
        wanted = [other for other in public(module) if not known(getattr(module, other), listed)]
        listed += [getattr(module, other) for other in wanted]
        text = chapter(f"pliant.{name}", module, wanted)
        texts[f"{name}.md"] = text.replace("\n\n", f"\n\n{heading}.\n\n", 1)
    forgotten = [name for name in public(pliant) if not known(getattr(pliant, name), listed)]
    if forgotten:
        raise ExtensionError(f"docs/ext/reference.py: no page for {forgotten}")
    toc = "\n".join(name.removesuffix(".md") for name in texts)
    texts["index.md"] = (
        "# API reference\n\nMade from the docstrings of the package and, for the compiled part, of "
        "its stub. Shapes: n joints, k axes of the task, N configurations or ticks; units in "
        f"brackets. Numbers in round brackets are equations of [the paper](../references.md).\n\n"
        f"```{{toctree}}\n:maxdepth: 2\n\n{toc}\n```\n"
    )
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def signature(app, what, name, thing, options, given, result):
    """Return the signature of a compiled item from the stub; None for other items."""
    short = name.removeprefix("pliant.")
    called = what in {"class", "method", "function"} and short in KNOWN
    return (KNOWN[short], "") if called else None


def plain(app, what, name, thing, options, lines):
    """Escape reStructuredText markup outside of back-quotes."""
    for i, line in enumerate(lines):
        pieces = re.split(r"(``[^`]*``|`[^`]*`)", line)
        pieces[::2] = [
            re.sub(r"([|*])(?=\S)|(?<=\w)(_)(?=\W|$)", r"\\\g<0>", p) for p in pieces[::2]
        ]
        lines[i] = "".join(pieces)


#: Replaces a colon in an attribute's docstring: napoleon takes the text before it for a type.
COLON = "\ue000"


def hide(app, what, name, thing, options, lines):
    """Hide colons in attributes' docstrings; Sphinx calls it before napoleon."""
    if what in {"attribute", "property", "data"}:
        lines[:] = [line.replace(":", COLON) for line in lines]


def reveal(app, what, name, thing, options, lines):
    """Restore the hidden colons; Sphinx calls it after napoleon."""
    lines[:] = [line.replace(COLON, ":") for line in lines]


def setup(app):
    """Connect to Sphinx."""
    app.connect("builder-inited", write)
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-docstring", plain, priority=400)
    app.connect("autodoc-process-docstring", hide, priority=401)  # napoleon's priority is 500
    app.connect("autodoc-process-docstring", reveal, priority=600)
    return {"parallel_read_safe": True}
