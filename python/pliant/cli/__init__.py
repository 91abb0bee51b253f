"""Command line of `pliant`: runs the named command, prints its errors, returns an exit code."""

from __future__ import annotations

import codecs
import contextlib
import difflib
import io
import logging
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from pliant._core import PliantError, __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: Maximum number of existing files that the error about a missing file lists.
MAX_LISTED_FILES = 8
#: Module and summary of each command, in the groups that --help shows. A command's module is
#: imported when the command is called; the arguments of its function `run` are the flags.
GROUPS = {
    "control an arm": {
        "run": ("pliant.cli.run", "hold an arm compliantly, or let it follow targets"),
        "view": (
            "pliant.cli.view",
            "control an arm, simulated or real, from a page in the browser",
        ),
        "ros": ("pliant.cli.ros", "let ROS 2 nodes control an arm, without ROS on its computer"),
        "foxglove": ("pliant.cli.foxglove", "show an arm live in Foxglove"),
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
#: Module and summary of each command; the entries of all groups of `GROUPS`.
COMMANDS = {name: entry for group in GROUPS.values() for name, entry in group.items()}
#: First words of two-word commands, such as `log` of `pliant log plot`.
PREFIXES = tuple(dict.fromkeys(name.split()[0] for name in COMMANDS if " " in name))
#: Exit code after a reported error, such as an invalid file or an unknown flag.
ERROR_EXIT = 2
#: Exit code after Ctrl-C, as in a shell: 128 + SIGINT.
INTERRUPT_EXIT = 130
#: Exit code if the output pipe is closed, as in a shell: 128 + SIGPIPE.
CLOSED_PIPE_EXIT = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command of `pliant`.

    Args:
        arguments: Command-line words without the program name; None: the words in `sys.argv`.

    Returns:
        Exit code: 0 on success, 1 if the user declined a prompt, 2 after a reported error, 128 plus
        the number of a signal (130 after Ctrl-C), 141 if the output pipe is closed.
    """
    return _guarded(lambda: _run(list(sys.argv[1:] if arguments is None else arguments)))


def program(
    run: Callable[..., object], prog: str, summary: str, arguments: Sequence[str] | None = None
) -> int:
    """Run a function as a separate program, with flags and error messages like a `pliant` command.

    Args:
        run: Function whose arguments are the flags.
        prog: Name of the program in its help.
        summary: Description of the program in one line.
        arguments: Command-line words without the program name; None: the words in `sys.argv`.

    Returns:
        Exit code, with the meanings listed at `main`.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    return _guarded(lambda: _call(lambda: run, prog, summary, words))


def _guarded(call: Callable[[], int]) -> int:
    """Call a function and flush the output; return its code, or `CLOSED_PIPE_EXIT`."""
    _prepare_streams()
    try:
        return call()
    except BrokenPipeError:  # `pliant … | head`: the reader has closed the pipe
        return CLOSED_PIPE_EXIT
    finally:
        _flush_output()


def _run(words: list[str]) -> int:
    """Run the command named by the first one or two command-line words; return its exit code."""
    first = words[0] if words else "--help"
    if first in {"--version", "-V"}:
        print(f"pliant {__version__}")
        return 0
    if first in {"--help", "-h"}:
        print(usage())
        return 0
    if first in PREFIXES and (len(words) == 1 or words[1] in {"--help", "-h"}):
        print(usage(first))
        return 0
    word_count = 2 if first in PREFIXES else 1
    name = " ".join(words[:word_count])
    if name not in COMMANDS:
        kind = "flag" if first.startswith("-") else "command"
        return _print_error(f"there is no {kind} {name!r}{_hint(name)} (pliant --help lists them)")
    # Only debug messages tell whether a simulated arm was lowered or left with torque on.
    logging.getLogger("pliant.arm").setLevel(logging.DEBUG)
    module, summary = COMMANDS[name]
    return _call(lambda: import_module(module).run, f"pliant {name}", summary, words[word_count:])


def _call(
    load: Callable[[], Callable[..., object]], prog: str, summary: str, words: list[str]
) -> int:
    """Call the function from `load` with the parsed flags; print errors; return the exit code."""
    try:
        import tyro

        tyro.cli(
            load(),
            prog=prog,
            description=summary[0].upper() + summary[1:] + ".",
            args=words,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        )
    except OSError as error:
        # A closed terminal also raises an OSError; the exit code must then be that of SIGHUP.
        if (code := _signal_exit_code(error)) is not None:
            return code
        if isinstance(error, BrokenPipeError):
            raise
        return _print_error(_describe(error))
    except (PliantError, ImportError) as error:
        error_code = _print_error(str(error))
        return error_code if (code := _signal_exit_code(error)) is None else code
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else ERROR_EXIT
    except KeyboardInterrupt:
        return INTERRUPT_EXIT
    return 0


def usage(prefix: str = "") -> str:
    """Return the text of `pliant --help`, or of `pliant PREFIX --help`."""
    width = max(map(len, COMMANDS))
    lines = []
    for title, group in GROUPS.items():
        shown = {name: entry for name, entry in group.items() if name.startswith(prefix)}
        if shown:
            lines += [f"{title}:"]
            lines += [f"  {name:<{width}}  {summary}" for name, (_, summary) in shown.items()]
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
    """Return "; did you mean ...?" with the command that resembles an unknown name, or ""."""
    names = {word: full for full in COMMANDS for word in (full, full.split()[-1])}
    for word in (name, name.rsplit(maxsplit=1)[-1], name.split(maxsplit=1)[0]):
        if close := difflib.get_close_matches(word, names, n=1):
            return f"; did you mean `pliant {names[close[0]]}`?"
    return ""


def _describe(error: OSError) -> str:
    """Return the text of an error of the operating system, without its number.

    About a missing file, it names the missing folder, or similar files.
    """
    if error.strerror is None:
        return str(error)
    if not isinstance(error.filename, str | bytes):  # None, or the number of an open file
        return error.strerror
    path = Path(os.fsdecode(error.filename))
    if not isinstance(error, FileNotFoundError):
        return f"{path}: {error.strerror}"
    if not path.absolute().parent.is_dir():
        return f"there is no folder {path.absolute().parent} for {path.name}"
    similar = sorted(other.name for other in path.absolute().parent.glob(f"*{path.suffix}"))[
        :MAX_LISTED_FILES
    ]
    hint = f"; there are {', '.join(similar)}" if path.suffix and similar else ""
    return f"there is no file {path}{hint}"


def _print_error(message: str) -> int:
    """Print an error message to stderr, with its line breaks; return `ERROR_EXIT`."""
    lines = [" ".join(line.split()) for line in message.splitlines() if line.strip()]
    with contextlib.suppress(OSError):
        print("error:", "\n       ".join(lines), file=sys.stderr)
    return ERROR_EXIT


def _signal_exit_code(error: BaseException) -> int | None:
    """Return 128 plus the signal that caused an exception; None if no signal caused it."""
    from pliant.arm._signals import signal_of

    number = signal_of(error)
    return None if number is None else 128 + number


def _prepare_streams() -> None:
    """Open closed standard streams on the null device; let output replace unknown characters.

    Otherwise the next file that the command opens would get the descriptor of a closed stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        # A locale such as C has no µ; its "surrogateescape" does not encode it either.
        if isinstance(stream, io.TextIOWrapper) and codecs.lookup(stream.encoding).name != "utf-8":
            stream.reconfigure(errors="replace")


def _flush_output() -> None:
    """Flush stdout and stderr; redirect a stream whose reader is gone to the null device."""
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
