"""The command `pliant`: one file per command, imported only when it is called."""

from __future__ import annotations

import contextlib
import difflib
import logging
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from pliant._core import PliantError, __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: Largest number of files listed when a file is missing.
SHOWN = 8
#: Commands in the groups that --help shows, each with its module and summary. The module has a
#: function `run` whose arguments are the flags.
GROUPS = {
    "control an arm": {
        "run": ("pliant.cli.run", "hold an arm compliantly, or let it follow targets"),
        "view": (
            "pliant.cli.view",
            "control an arm, simulated or real, from a page in the browser",
        ),
        "teach": ("pliant.cli.teach", "record a motion by leading the arm by hand"),
        "replay": ("pliant.cli.replay", "play a motion compliantly"),
        "identify": ("pliant.cli.identify", "measure the servos, gravity or payload of an arm"),
    },
    "servos": {
        "servos scan": ("pliant.cli.servos.scan", "find servos: ports, speeds, ids, models"),
        "servos setup": ("pliant.cli.servos.setup", "write the EEPROM of servos, or undo that"),
        "servos doctor": ("pliant.cli.servos.doctor", "check configuration, ports and servos"),
        "servos emulate": ("pliant.cli.servos.emulate", "emulate an arm's servos on a serial port"),
    },
    "logs": {
        "log info": ("pliant.cli.log.info", "show the contents of a log"),
        "log plot": ("pliant.cli.log.plot", "draw joints and task of a log"),
        "log export": ("pliant.cli.log.export", "convert a log to a table"),
        "log report": ("pliant.cli.log.report", "write a page that says why the arm was soft"),
        "log verify": ("pliant.cli.log.verify", "run the controller again, compare every command"),
    },
    "configuration": {
        "arms": ("pliant.cli.arms", "list the ready arms, or print the file of one"),
    },
}
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
#: First words of two-word commands.
PREFIXES = tuple(dict.fromkeys(name.split()[0] for name in COMMANDS if " " in name))
#: Exit code of an explained error, also of an unknown flag.
EXPLAINED = 2
INTERRUPTED = 130
CUT_OFF = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: Without the program name; default those of the process.

    Returns:
        Exit code: 0, 1 for a prompt that the user declined, 2 for an error that was explained in
        one line, 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP, 131 after SIGQUIT, 141 if
        its output pipe is closed.
    """
    return _guarded(lambda: _run(list(sys.argv[1:] if arguments is None else arguments)))


def program(
    run: Callable[..., object], prog: str, summary: str, arguments: Sequence[str] | None = None
) -> int:
    """Run a function as a program of its own, with the flags and errors of a command.

    Args:
        run: The function; its arguments are the flags.
        prog: Name of the program in its help.
        summary: One line for its help.
        arguments: Without the program name; default those of the process.

    Returns:
        Exit code, as `main`.
    """
    arguments_given = list(sys.argv[1:] if arguments is None else arguments)
    return _guarded(lambda: _call(lambda: run, prog, summary, arguments_given))


def _guarded(call: Callable[[], int]) -> int:
    """Return the exit code of a call; handle a closed output."""
    try:
        return call()
    except BrokenPipeError:  # `pliant … | head`: the reader has closed the pipe
        return CUT_OFF
    finally:
        _let_go_of_dead_readers()


def _run(arguments_given: list[str]) -> int:
    """Run a command by its name."""
    first = arguments_given[0] if arguments_given else "--help"
    if first in {"--version", "-V"}:
        print(f"pliant {__version__}")
        return 0
    if first in {"--help", "-h"}:
        print(usage())
        return 0
    if first in PREFIXES and (len(arguments_given) == 1 or arguments_given[1] in {"--help", "-h"}):
        print(usage(first))
        return 0
    words = 2 if first in PREFIXES else 1
    name = " ".join(arguments_given[:words])
    if name not in COMMANDS:
        kind = "flag" if first.startswith("-") else "command"
        return _explain(f"there is no {kind} {name!r}{_hint(name)} (pliant --help lists them)")
    # Commands also log how they leave an arm.
    logging.getLogger("pliant.arm").setLevel(logging.DEBUG)
    module, summary = COMMANDS[name]
    return _call(
        lambda: import_module(module).run, f"pliant {name}", summary, arguments_given[words:]
    )


def _call(
    load: Callable[[], Callable[..., object]], prog: str, summary: str, arguments_given: list[str]
) -> int:
    """Load a function, run it with flags as arguments, and explain its errors in one line."""
    try:
        import tyro

        tyro.cli(
            load(),
            prog=prog,
            description=summary[0].upper() + summary[1:] + ".",
            args=arguments_given,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        )
    except OSError as error:
        # If the terminal hangs up, the error comes from a signal.
        if (code := _signalled(error)) is not None:
            return code
        if isinstance(error, BrokenPipeError):
            raise
        return _explain(_not_there(error) if isinstance(error, FileNotFoundError) else str(error))
    except (PliantError, ImportError) as error:
        explained = _explain(str(error))
        return explained if (code := _signalled(error)) is None else code
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else EXPLAINED
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def usage(prefix: str = "") -> str:
    """Return the text of `pliant --help`, or of `pliant PREFIX --help`."""
    width = max(map(len, COMMANDS))
    lines = []
    for title, group in GROUPS.items():
        own = {name: entry for name, entry in group.items() if name.startswith(prefix)}
        if own:
            lines += [f"{title}:"]
            lines += [f"  {name:<{width}}  {summary}" for name, (_, summary) in own.items()]
            lines += [""]
    return "\n".join(
        (
            f"usage: pliant {prefix + ' ' if prefix else ''}COMMAND [FLAGS]",
            "",
            "Compliant task-space control for arms with back-drivable position servos.",
            "",
            *lines,
            "pliant COMMAND --help explains the flags of a command; pliant --version prints the "
            "version.",
        )
    )


def _hint(name: str) -> str:
    """Suggest the command whose name, or last word, is closest to an unknown word."""
    names = {word: full for full in COMMANDS for word in (full, full.split()[-1])}
    for word in (name, name.rsplit(maxsplit=1)[-1], name.split(maxsplit=1)[0]):
        if close := difflib.get_close_matches(word, names, n=1):
            return f"; did you mean `pliant {names[close[0]]}`?"
    return ""


def _not_there(error: FileNotFoundError) -> str:
    """Return an error text with the missing file and the similar files in its folder."""
    if error.filename is None:
        return str(error)
    path = Path(os.fsdecode(error.filename))
    if not path.absolute().parent.is_dir():
        return f"there is no folder {path.absolute().parent} for {path.name}"
    there = sorted(other.name for other in path.absolute().parent.glob(f"*{path.suffix}"))[:SHOWN]
    hint = f"; there are {', '.join(there)}" if path.suffix and there else ""
    return f"there is no file {path}{hint}"


def _explain(message: str) -> int:
    """Print an error, one line per problem."""
    lines = [" ".join(line.split()) for line in message.splitlines() if line.strip()]
    with contextlib.suppress(OSError):
        print("error:", "\n       ".join(lines), file=sys.stderr)
    return EXPLAINED


def _signalled(error: BaseException) -> int | None:
    """Return the exit code of the signal behind an exception, None without a signal."""
    from pliant.arm._signals import signal_of

    number = signal_of(error)
    return None if number is None else 128 + number


def _let_go_of_dead_readers() -> None:
    """Flush the output; redirect closed streams to the null device."""
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
