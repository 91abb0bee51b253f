"""Accuracy of promised caps: the distribution of felt minus promised, one line per group."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._report.style import BLUE, CARD, MUTED, SKY, WIDE, canvas, save

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from experiments.campaign_bench import Promise

    #: Promises by the label of their line.
    Groups = Mapping[str, Sequence[Promise]]


def draw(panels: Mapping[str, Groups], folder: Path, stem: str) -> None:
    """Draw one panel beside the other, each of its groups a line; refused promises are left out.

    Args:
        panels: Groups by the panel's title.
        folder: Target folder.
        stem: Name of the picture's files.
    """
    lines = max(4, *(len(groups) for groups in panels.values()))
    with canvas(1, len(panels), size=(WIDE, 1.2 + 0.42 * lines)) as (figure, axes):
        for ax, (title, groups) in zip(axes[0], panels.items(), strict=True):
            _strips(ax, groups)
            ax.set_title(title)
        save(figure, folder, stem)


def _strips(ax: Any, groups: Groups) -> None:
    """Draw a line per group: the middle 95 % and half of the errors, median, share in band."""
    for place, promises in enumerate(reversed(list(groups.values()))):
        run = [p for p in promises if not p.refused]
        if not run:
            continue
        marks = 100.0 * np.quantile([p.error for p in run], (0.025, 0.25, 0.5, 0.75, 0.975))
        low, a, middle, b, high = np.clip(marks, -100.0, 100.0)
        ax.plot((low, high), (place, place), color=SKY, linewidth=2.0)
        ax.plot((a, b), (place, place), color=BLUE, linewidth=6.0)
        ax.plot(middle, place, "|", color=CARD, markersize=8, markeredgewidth=1.5)
        share = 100.0 * float(np.mean([p.kept for p in run]))
        ax.annotate(
            f"{share:.1f} % in band",
            (1.0, place),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="center",
            fontsize=7.5,
            color=MUTED,
        )
    ax.set_yticks(range(len(groups)), list(reversed(list(groups))))
    ax.set_xlim(-105.0, 185.0)
    ax.set_xticks((-100, -50, 0, 50, 100), ("≤ −100", "−50", "0", "50", "≥ 100"))
    ax.set_ylim(-0.6, len(groups) - 0.2)
    ax.axvline(0.0, color=MUTED, linewidth=0.7)
    ax.set_xlabel("felt − promised [% of the cap]: middle 95 %, half, median")
