"""`rig reproduce`: run the experiments behind the published tables and figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rig.cli.exits import OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import RigError
from rig.experiments.reproduce import ITEMS, Job, Outcome, find_item, run_item

DEFAULT_FOLDER = Path("runs") / "reproduce"


def reproduce(
    *,
    only: str | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    list_items: Annotated[bool, Parameter(name="--list", negative="")] = False,
    out: Path = DEFAULT_FOLDER,
    processes: int | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Run the experiments behind the published tables and figures.

    After Ctrl-C the same command goes on where it stopped.

    Parameters
    ----------
    only:
        One experiment, or several separated by commas; all when absent. See --list.
    quick:
        The smallest run that shows the same.
    list_items:
        Name every experiment and what it shows, and run none.
    out:
        Folder of the results: values as JSON, words as Markdown, figures as SVG.
    processes:
        How many to work in; one a core when absent.
    """
    if list_items:
        told = {name: item.shows for name, item in ITEMS.items()}
        terminal.result("\n".join(f"{name:<18}{shows}" for name, shows in told.items()), told)
        return OK
    names = [name.strip() for name in only.split(",")] if only is not None else list(ITEMS)
    for name in names:
        find_item(name)
    results, texts = {}, []
    for name in names:
        folder = work_folder(out, name, quick)
        terminal.say(f"{name}: {ITEMS[name].shows}; in {folder}")
        with terminal.progress(name, None) as advance:
            job = Job(folder, quick, processes, terminal.say, advance)
            outcome = run_item(name, job)
        _write(folder, name, outcome)
        results[name] = outcome.values
        texts.append(f"{name}\n\n{outcome.words}\n")
    terminal.result("\n".join(texts), results)
    return OK


def _write(folder: Path, name: str, outcome: Outcome) -> None:
    values = json.dumps(outcome.values, indent=2)
    (folder / f"{name}.json").write_text(values + "\n", encoding="utf-8")
    (folder / f"{name}.md").write_text(outcome.words + "\n", encoding="utf-8")
    if outcome.svg:
        (folder / f"{name}.svg").write_text(outcome.svg, encoding="utf-8")


def work_folder(out: Path, name: str, quick: bool) -> Path:
    """Return the folder of an experiment, made where it is not there; quick runs have their own."""
    folder = out / (f"{name}-quick" if quick else name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"--out {folder} cannot be made: {error.strerror}; name another") from None
    return folder
