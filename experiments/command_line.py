"""Command lines of the experiments' programs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from collections.abc import Callable

#: Type of a command-line option that names an arm and can be repeated.
Arms = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


def start(main: Callable[..., None]) -> None:
    """Run the `main` function of a module that Python runs as `__main__`.

    The parameters of `main` become command-line options, and its docstring their help. The module
    is imported again by its full name, because other processes import the jobs by this name.

    Args:
        main: Function `main` of the module.
    """
    module = import_module(main.__globals__["__spec__"].name)
    tyro.cli(getattr(module, main.__name__))
