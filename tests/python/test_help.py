"""`help()`: every public compiled class, member and function has the docstring of the stub."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import pliant
from pliant import _core

STUB = Path(pliant.__file__).with_name("_core.pyi")


def documented(node: ast.Module | ast.ClassDef, owner: str = "") -> dict[str, str]:
    """Return the docstrings of public classes, members and functions of the stub, by name.

    The docstrings of overloads are joined.
    """
    docstrings: dict[str, list[str]] = {}
    # Functions that Windows lacks are below an `if`.
    windows = sys.platform == "win32"
    items = []
    for item in node.body:
        items += [item] if not isinstance(item, ast.If) else [] if windows else item.body
    for item in items:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            # An attribute that can be set; those of exceptions are not compiled.
            members = vars(getattr(_core, owner.removesuffix("."), object))
            if inspect.isgetsetdescriptor(members.get(item.target.id)):
                docstrings[owner + item.target.id] = []
        if not isinstance(item, ast.ClassDef | ast.FunctionDef):
            continue
        if item.name.startswith("_"):
            continue
        name = owner + item.name
        docstrings.setdefault(name, []).extend([text] if (text := ast.get_docstring(item)) else [])
        if isinstance(item, ast.ClassDef):
            docstrings.update({k: [v] for k, v in documented(item, f"{item.name}.").items()})
    return {name: "\n\n".join(texts) for name, texts in docstrings.items()}


def expected(name: str) -> str:
    """Return the docstring that `help()` must show; for an attribute, the text of its argument."""
    head, _, member = name.partition(".")
    if text := DOCUMENTED[name] or not member:
        return text
    entry = re.search(
        rf"^    {member}: (.*\n(?:        .*\n)*)", f"{DOCUMENTED[head]}\n", re.MULTILINE
    )
    assert entry, "neither a docstring nor an argument of the class"
    return inspect.cleandoc(re.sub(r"^ +", "", entry[1], flags=re.MULTILINE))


DOCUMENTED = documented(ast.parse(STUB.read_text(encoding="utf-8")))
MODULES = (
    *(pliant, pliant.feasibility, pliant.functional, pliant.model),
    *(pliant.arm, pliant.teleop, pliant.types),
)
#: Names that users reach; the docstrings of the others are in the stub only.
PUBLIC = {name for module in MODULES for name in module.__all__}


def compiled(name: str) -> object:
    """Return the class, function, or the object behind a member's name."""
    head, _, member = name.partition(".")
    owner = getattr(_core, head)
    return inspect.getattr_static(owner, member) if member else owner


@pytest.mark.parametrize("name", DOCUMENTED)
def test_help_is_the_text_of_the_stub(name):
    text = expected(name)
    assert text, "the stub says nothing"
    compiled_object = compiled(name)
    shown = inspect.cleandoc(getattr(compiled_object, "__func__", compiled_object).__doc__ or "")
    assert shown == (text if name.partition(".")[0] in PUBLIC else "")


def test_every_public_member_is_in_the_stub():
    public = {
        name for name in dir(_core) if not name.startswith("_") and callable(getattr(_core, name))
    }
    for name in sorted(public):
        if inspect.isclass(owner := getattr(_core, name)):
            members = {m for m in vars(owner) if not m.startswith("_")}
            public |= {f"{name}.{m}" for m in members if not issubclass(owner, Exception)}
    assert public == set(DOCUMENTED)
    assert len(public) > 250


@pytest.mark.parametrize(
    ("name", "signature"),
    [
        ("Model.gravity", "(self, /, q)"),
        ("Controller.report", "(self, /, q=None)"),
        ("Payload", "(mass, com=(0.0, 0.0, 0.0))"),
        ("null_space_projector", "(J, damping=0.0, kind='exact')"),
        ("Settings.drawer", "(*, axis='x', pull=None, **overrides)"),
    ],
)
def test_signatures_stay_beside_the_text(name, signature):
    head, _, member = name.partition(".")
    owner = getattr(_core, head)
    assert str(inspect.signature(getattr(owner, member) if member else owner)) == signature


def test_an_object_of_another_kind_is_answered_with_how_to_get_one(model):
    controller = pliant.Controller(model)
    for call, description in (
        (lambda: pliant.Controller("arm7"), r"model must be a Model, as pliant\.robots\.arm7\(\)"),
        (
            lambda: pliant.feasibility.check_path("arm7", pliant.Settings(), np.eye(4)),
            "model must be a Model",
        ),
        (lambda: pliant.Settings.firm().raise_soft("arm7"), "model must be a Model"),
        (lambda: pliant.Controller(model, "y"), r"settings must be Settings, e\.g\. .*got 'y'"),
        (lambda: controller.update("y"), "settings must be Settings"),
        (lambda: pliant.Controller(model, None, "sts3215"), r"servos must be Servos, e\.g\."),
        (lambda: model.with_servos("sts3215"), r"servos must be Servos, e\.g\."),
        (lambda: pliant.ContactEstimator(model), r"controller must be a Controller.*\(Model\)"),
    ):
        with pytest.raises(TypeError, match=description):
            call()


def test_an_unknown_keyword_gets_the_list_of_keywords():
    with pytest.raises(pliant.ConfigError, match=r"no such field\. Fields: task, axes"):
        pliant.Settings.soft("y", qqqqq=1)
    with pytest.raises(pliant.ConfigError, match=r"no such keyword\. Keywords: base"):
        pliant.Model.from_urdf_str("<robot/>", qqqqq=1)
