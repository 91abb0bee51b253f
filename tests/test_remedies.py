"""Every remedy that an error text names exists: commands, flags, calls, keywords, keys, pages."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import tomllib
import warnings
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="texts name parts of the extra sim")
pytest.importorskip("rustypot", reason="texts name parts of the extra servo")
pytest.importorskip("mcap", reason="texts name parts of the extra log")

import tyro

import pliant
from pliant.cli import COMMANDS
from pliant.cli import main as cli_main
from pliant.config.factory import ARM_OPTIONS, FILE_OPTIONS, PLANT_OPTIONS
from pliant.config.schema import Config

ROOT = Path(__file__).resolve().parents[1]
MODULES = [pliant] + [
    import_module(f"pliant.{name}")
    for name in (
        *("arm", "config", "functional", "identify", "log", "loop", "reactions", "robots"),
        *("emulator", "servo", "sim", "teach", "view"),
    )
]
#: Variable names in error texts, and the classes of the objects that they stand for.
OBJECTS = {
    "arm": import_module("pliant.arm").Arm,
    "controller": pliant.Controller,
    "model": pliant.Model,
    "servos": pliant.Servos,
    "settings": pliant.Settings,
    "task": pliant.Task,
    "tracking": pliant.Tracking,
    "null_space": pliant.NullSpace,
    "compensation": pliant.Compensation,
    "torque_limits": pliant.TorqueLimits,
    "paper_options": pliant.functional.PaperOptions,
    "payload": pliant.Payload,
    "tick": import_module("pliant.loop").Tick,
    "recorder": import_module("pliant.log").Recorder,
    "found": import_module("pliant.identify").GravityCapture,
    "array": np.ma.MaskedArray,
}
#: Words after "pliant" in error texts that are not commands.
NOT_COMMANDS = {"arm", "counts", "does", "motion", "reads", "task", "was"}
#: Units and markup tags of rich, which are in brackets like the tables of a configuration.
UNITS = {"m", "mm", "ms", "kg", "rad", "s", "bold", "dim", "green", "red", "yellow"}
#: Words that may follow the name of a table in a sentence.
BESIDE_SECTION = {"a", "and", "in", "of", "the"}
#: Values that replace the placeholders of a command.
PLACEHOLDERS = {"ARM": "so101", "OLD:NEW": "1:2"}


def python_texts(path: Path) -> list[str]:
    """Return the string literals of a module except docstrings; f-string fields become "..."."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs, parts, texts = set(), set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docs.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            parts |= {id(part) for part in node.values}
            texts.append(
                "".join(
                    getattr(part, "value", "…") if isinstance(part, ast.Constant) else "…"
                    for part in node.values
                )
            )
    texts += [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in docs | parts
    ]
    return [text for text in texts if " " in text and not is_markup(text)]


def is_markup(text: str) -> bool:
    """Return True if a string is HTML, CSS or JavaScript."""
    return (
        re.search(r"</|/>|<\w+ |\bfunction\b|\w+:has\(|rgba\(|charset=|\b(?:class|style)=", text)
        is not None
    )


RUST = re.compile(
    r"""//[^\n]*|'(?:\\.|[^'\\\n])'|r(\#*)".*?"\1|"(?P<text>(?:[^"\\]|\\.)*)\"""", re.DOTALL
)


def rust_texts(path: Path) -> list[str]:
    """Return the string literals of a Rust file that are sentences; tests are left out."""
    code = path.read_text(encoding="utf-8").split("#[cfg(test)]")[0]
    literals = [match["text"] for match in RUST.finditer(code) if match["text"] is not None]
    texts = [re.sub(r"\\\n\s*", "", text).replace('\\"', '"') for text in literals]
    return [re.sub(r"\{[^{}]*\}", "…", text) for text in texts if " " in text]


@cache
def texts() -> dict[str, str]:
    """Return the string literals of the package, with the file of each."""
    python = sorted((ROOT / "python" / "pliant").rglob("*.py"))
    rust = sorted(
        path for crate in ("core", "py") for path in (ROOT / "rust" / crate / "src").rglob("*.rs")
    )
    result = {}
    for paths, extract in ((python, python_texts), (rust, rust_texts)):
        for path in paths:
            for text in extract(path):
                result[text] = path.relative_to(ROOT).as_posix()
    return result


def invalid_remedies(find, judge) -> list[str]:
    """Return the texts that name a remedy that does not exist.

    `find` returns the remedies in a text, `judge` whether one exists.
    """
    return [
        f"{file}: {remedy!r} in {text!r}"
        for text, file in texts().items()
        for remedy in find(text, file)
        if not judge(remedy)
    ]


def command_of(tokens: list[str]) -> tuple[str, list[str]]:
    """Return the command at the beginning of a list of words ("" if none), and the other words."""
    for size in (2, 1):
        if " ".join(tokens[:size]) in COMMANDS:
            return " ".join(tokens[:size]), tokens[size:]
    return "", tokens


@cache
def parser(command: str):
    """Return the argument parser of a `pliant` command."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return tyro.extras.get_parser(
            import_module(COMMANDS[command][0]).run,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        )


def flags(command: str) -> set[str]:
    """Return the flags of a command."""
    return set(parser(command)._option_string_actions)


def test_texts_are_found():
    """Check that texts are extracted at all: without texts, the tests below would pass."""
    assert len(texts()) > 1000
    for sure in (
        "`pliant servos setup ARM --set-id OLD:NEW`",
        "connect(..., rest_q=[...])",
        "[robot] urdf",
    ):
        assert any(sure in text for text in texts()), sure


def commands(text: str, _file: str) -> list[str]:
    return re.findall(r"\bpliant ((?:[a-z]+)(?: (?:--[a-z-]+|[a-z]+|[A-Z:]+)(?=[ `:]|$))*)", text)


def is_command(text: str) -> bool:
    """Return True if a command exists with the flags and the first argument in this text.

    Also True for a text that begins with a word of `NOT_COMMANDS`.
    """
    command, arguments = command_of(text.split())
    if text.split(maxsplit=1)[0] in NOT_COMMANDS:
        return True
    if not command:
        return False
    flag_names = [token for token in arguments if token.startswith("--")]
    if not set(flag_names) <= flags(command):
        return False
    choices = next((a.choices for a in parser(command)._actions if a.choices), None)
    return choices is None or not arguments or arguments[0] in choices


def test_commands_exist_with_their_flags():
    candidates = [command for text, file in texts().items() for command in commands(text, file)]
    assert len([command for command in candidates if command_of(command.split())[0]]) > 20
    assert invalid_remedies(commands, is_command) == []


def quoted_commands(text: str, _file: str) -> list[str]:
    return [command for command in re.findall(r"`pliant ([^`]+)`", text) if "…" not in command]


def is_accepted(text: str) -> bool:
    """Return True if the parser of a command accepts it as written; the command does not run."""
    command, arguments = command_of([PLACEHOLDERS.get(token, token) for token in text.split()])
    if not command:
        return False
    with pytest.MonkeyPatch.context() as patch:
        module, actions = import_module(COMMANDS[command][0]), []
        run = module.run

        def pretend(*args, **keywords):
            actions.append((args, keywords))

        pretend.__signature__ = inspect.signature(run, eval_str=True)
        pretend.__doc__, pretend.__name__ = run.__doc__, run.__name__
        pretend.__annotations__ = inspect.get_annotations(run, eval_str=True)
        patch.setattr(module, "run", pretend)
        required = [a for a in parser(command)._actions if not a.option_strings and a.required]
        positionals = [
            token
            for token in arguments
            if not token.startswith("--") and not re.match(r"\d+:", token)
        ]
        cli_main([*command.split(), *arguments, *("so101" for _ in required[len(positionals) :])])
        return bool(actions)


def test_quoted_commands_are_taken_by_the_shell(capsys):
    assert invalid_remedies(quoted_commands, is_accepted) == [], capsys.readouterr().err


def flags_of(text: str, file: str) -> list[tuple[str, str]]:
    """Return the flags in a text, each with its command, or "" if it may be any command."""
    path = file.removeprefix("python/pliant/cli/").removesuffix(".py")
    command = path.replace("/", " ") if path != file.removesuffix(".py") else ""
    plain = re.sub(r"`[^`]*`|pliant [a-z]+ [^;,:.]*", "", text)
    return [
        (flag, command if command in COMMANDS else "")
        for flag in re.findall(r"(?<![\w-])--[a-z][a-z-]*", plain)
    ]


def is_flag(remedy: tuple[str, str]) -> bool:
    flag, command = remedy
    allowed = {"--version"} | {flag for name in [command] if name for flag in flags(name)}
    all_flags = {flag for name in COMMANDS for flag in flags(name)} | {"--version", "--python"}
    return flag in (allowed if command else all_flags)


def test_flags_exist():
    assert invalid_remedies(flags_of, is_flag) == []


def members(name: str) -> list[object]:
    """Return the objects with this name in the public modules and in their classes."""
    matches = [getattr(module, name) for module in MODULES if hasattr(module, name)]
    classes = {
        item for module in MODULES for item in vars(module).values() if isinstance(item, type)
    }
    lazy = {
        getattr(module, exported)
        for module in MODULES
        for exported in getattr(module, "__all__", ())
        if isinstance(getattr(module, exported, None), type)
    }
    return matches + [getattr(item, name) for item in classes | lazy if hasattr(item, name)]


def resolve(dotted: str) -> list[object]:
    """Return all objects that a dotted name may refer to."""
    head, *tail = dotted.split(".")
    if head == "pliant" and tail:
        with contextlib.suppress(ImportError):
            import_module(f"pliant.{tail[0]}")
        owners: list[object] = [pliant]
    elif head in OBJECTS:
        owners = [OBJECTS[head]]
    else:
        owners = members(head)
    for name in tail:
        fields = {id(item): getattr(item, "__annotations__", {}) for item in owners}
        owners = [
            getattr(item, name, fields[id(item)].get(name))
            for item in owners
            if hasattr(item, name) or name in fields[id(item)]
        ]
    return owners


def keywords(item: object) -> set[str]:
    """Return the keywords that a callable takes."""
    if item is pliant.connect:
        return {*ARM_OPTIONS, *FILE_OPTIONS, *PLANT_OPTIONS, "q", "real_time"}
    try:
        return set(inspect.signature(item).parameters)
    except (TypeError, ValueError):
        return set()


CALL = re.compile(r"(?<![\w.`'&])([A-Za-z_][\w.]*)\(((?:[^()\"]|\([^()]*\)|\"[^\"]*\")*)\)")


def calls(text: str, _file: str) -> list[tuple[str, str]]:
    """Return the calls in a text, as name and arguments.

    `Command(...)` is left out: it is the `repr` of an object that users do not create.
    """
    return [call for call in CALL.findall(text) if call[0] != "Command"]


def takes(item: object, arguments: str) -> bool:
    """Return True if a function accepts these arguments; "..." stands for any arguments."""
    if not callable(item):
        return False
    flat = re.sub(r"\([^()]*\)|\[[^\[\]]*\]|\"[^\"]*\"", "0", arguments)
    parts = [part.strip() for part in flat.split(",") if part.strip()]
    keyword_names = {part.split("=")[0].strip() for part in parts if re.match(r"[a-z_]+\s?=", part)}
    if not keyword_names <= keywords(item):
        return False
    if "..." in flat or "…" in flat or item is pliant.connect:
        return True
    values = [None for part in parts if "=" not in part]
    itself = [None] if needs_object(item) else []
    try:
        inspect.signature(item).bind(*itself, *values, **dict.fromkeys(keyword_names))
    except TypeError:
        return False
    except ValueError:
        return True  # a builtin without a signature
    return True


def needs_object(item: object) -> bool:
    """Return True if a function must be called on an instance of a class."""
    if inspect.isfunction(item):
        return "." in item.__qualname__
    return inspect.ismethoddescriptor(item) and type(item).__name__ == "method_descriptor"


def is_callable_so(call: tuple[str, str]) -> bool:
    """Return True if a function or class with this name accepts these arguments."""
    name, arguments = call
    return any(takes(item, arguments) for item in resolve(name))


def test_calls_exist_with_their_keywords():
    candidates = [call for text, file in texts().items() for call in calls(text, file)]
    assert len(candidates) > 60
    assert invalid_remedies(calls, is_callable_so) == []


OPEN = re.compile(
    r"…|\.\.\.|\[N|\b(arm|found|path|position|quaternion|value|goal|drive|document|clock)\b"
)


def examples(text: str, _file: str) -> list[str]:
    """Return the calls in a text that run as they are, without a user's variables."""
    candidates = [f"{name}({arguments})" for name, arguments in CALL.findall(text)]
    return [
        call for call in candidates if not OPEN.search(call) and not is_method(call.split("(")[0])
    ]


def is_method(name: str) -> bool:
    """Return True if a dotted name is a method of an object in `OBJECTS`."""
    head, _, last = name.rpartition(".")
    if head in OBJECTS or (not head and not last[0].isupper() and not made_by(last)):
        return True
    owners = resolve(head) if head else []
    return any(
        isinstance(owner, type) and needs_object(inspect.getattr_static(owner, last))
        for owner in owners
    )


def made_by(name: str) -> bool:
    """Return True if a bare name is in `pliant` or in `pliant.robots`."""
    return name in pliant.__all__ or hasattr(pliant.robots, name)


def runs(call: str) -> bool:
    """Return True if a call in an error text runs unchanged."""
    names = {
        key: getattr(module, key)
        for module in reversed(MODULES)
        for key in {*vars(module), *getattr(module, "__all__", ())}
    }
    names |= {key: getattr(pliant.robots, key) for key in ("arm7", "so101", "koch")}
    names |= {"pliant": pliant, "model": pliant.robots.arm7(), "settings": pliant.Settings()}
    try:
        eval(call, names)
    except Exception as error:
        print(call, error)
        return False
    return True


def test_examples_run():
    candidates = [call for text, file in texts().items() for call in examples(text, file)]
    assert len(candidates) > 8
    assert invalid_remedies(examples, runs) == []


def accepted(text: str, _file: str) -> list[str]:
    return re.findall(r"\b(accept_\w+)=True", text)


def is_risk(risk: str) -> bool:
    """Return True if `Settings` or `ContactEstimator` has a flag of this name."""
    controller = pliant.Controller(pliant.robots.so101(), pliant.Settings(task="xyz"))
    for make in (
        lambda: pliant.Settings(**{risk: True}),
        lambda: pliant.ContactEstimator(controller, **{risk: True}),
    ):
        with contextlib.suppress(pliant.ConfigError, TypeError):
            make()
            return True
    return False


def test_risks_that_texts_name_can_be_accepted():
    assert [risk for text, file in texts().items() for risk in accepted(text, file)]
    assert invalid_remedies(accepted, is_risk) == []


@cache
def every_keyword() -> set[str]:
    """Return the keywords of all public callables."""
    names = set(keywords(pliant.connect)) | {"python"}
    for module in MODULES:
        for name in {*vars(module), *getattr(module, "__all__", ())}:
            item = getattr(module, name, None)
            if not callable(item) or name.startswith("_"):
                continue
            names |= keywords(item)
            if isinstance(item, type):
                names |= {
                    key for part in vars(item).values() if callable(part) for key in keywords(part)
                }
                names |= {
                    key
                    for name in dir(item)
                    if not name.startswith("_") and callable(getattr(item, name))
                    for key in keywords(getattr(item, name))
                }
    return names


def is_keyword(name: str) -> bool:
    """Return True if a public function or class has this keyword argument."""
    return name in every_keyword()


def bare_keywords(text: str, file: str) -> list[str]:
    # Attributes of a URDF, and the axis in `--soft y=2`, are not keyword arguments.
    if file.startswith("rust/core/src/model/") or "--soft" in text:
        return []
    return re.findall(r"(?<![\w.{])([a-z_]{2,})=(?![=>])", CALL.sub("", text))


def test_keywords_exist():
    candidates = [key for text, file in texts().items() for key in bare_keywords(text, file)]
    assert len(candidates) > 10
    assert invalid_remedies(bare_keywords, is_keyword) == []


def dotted_names(text: str, _file: str) -> list[str]:
    return re.findall(
        r"(?<![\w/.`'-])(pliant(?:\.[A-Za-z_]\w*)+|[A-Za-z_]\w+\.[a-z_]\w+)(?![\w(/])", text
    )


def is_dotted_name(name: str) -> bool:
    head, *tail = name.split(".")
    if tail[-1] in {"md", "urdf", "toml", "json", "mcap"}:
        return tail[-1] != "md" or any((ROOT / "docs").rglob(name))
    return bool(resolve(name)) or (head in Config.model_fields and is_section((head, tail[0])))


def test_names_and_pages_exist():
    assert invalid_remedies(dotted_names, is_dotted_name) == []


def sections(text: str, _file: str) -> list[tuple[str, str]]:
    pairs = re.findall(r"(?<![\w\])…])\[([a-z_]+)\](?: ([a-z_]+))?", text)
    return [pair for pair in pairs if pair[0] not in UNITS]


def is_section(pair: tuple[str, str]) -> bool:
    """Return True if the schema of configurations has this table, with this key."""
    section, key = pair
    fields = {field.alias or name: field for name, field in Config.model_fields.items()}
    if section not in fields:
        return False
    if not key or key in BESIDE_SECTION:
        return True
    inner = [
        part
        for part in (
            fields[section].annotation,
            *getattr(fields[section].annotation, "__args__", ()),
        )
        if hasattr(part, "model_fields")
    ]
    if section == "settings":
        return key in keywords(pliant.Settings)
    return any(key in part.model_fields for part in inner)


def test_sections_and_keys_of_a_configuration_exist():
    candidates = [pair for text, file in texts().items() for pair in sections(text, file)]
    assert len(candidates) > 8
    assert invalid_remedies(sections, is_section) == []


def test_extras_exist():
    """Check that the second argument of every call of `missing` is an extra in pyproject.toml."""
    known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = [
        node.args[1].value
        for folder in ("python/pliant", "experiments")
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and getattr(node.func, "id", "") == "missing"
        and isinstance(node.args[1], ast.Constant)
    ]
    assert len(extras) > 6
    assert set(extras) <= set(known["project"]["optional-dependencies"])


@pytest.mark.parametrize(
    ("text", "find", "judge"),
    [
        ("`pliant measure` measures k_p", commands, is_command),
        ("see pliant servos setup --set-ids for that", commands, is_command),
        ("draw it: pliant log draw of this", commands, is_command),
        ("`pliant servos setup ARM --deep`", quoted_commands, is_accepted),
        ("give --sped a number", flags_of, is_flag),
        ("arm.relax() first", calls, is_callable_so),
        ("give connect(..., rests=[...])", calls, is_callable_so),
        ("pliant.identify.run(arm) measures k_p", calls, is_callable_so),
        ("say Servos.of(['sts9999'])", examples, runs),
        ("accept the risk: Settings(accept_everything=True)", accepted, is_risk),
        ("or give payloads= as well", bare_keywords, is_keyword),
        ("set Budget.hotest lower", dotted_names, is_dotted_name),
        ("the page trouble_shooting.md", dotted_names, is_dotted_name),
        ("as [servos] says", sections, is_section),
        ("raise [loop] speed", sections, is_section),
    ],
)
def test_a_remedy_that_does_not_exist_is_found(text, find, judge, monkeypatch):
    monkeypatch.setitem(globals(), "texts", lambda: {text: "python/pliant/cli/run.py"})
    assert len(invalid_remedies(find, judge)) == 1
