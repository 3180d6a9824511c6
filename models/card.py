"""The model card: where a network's data came from, how to make it again, and its limits."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qs

from rig.core.types import THESIS_LIMITS
from rig.models.export import LICENCE, Parity, int8_file
from rig.models.fit import EpochLoss, Recipe
from rig.models.networks import NETWORKS
from rig.models.split import Split
from rig.models.targets import RecordingSource, Targets
from rig.models.timing import BAYER_PX, Cost


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """A trained and exported network; `best_epoch` counts from 0 and is the one exported.

    `costs` are those of the float32 file and of the one in 8-bit integers, where there is one.
    """

    model: Path
    card: Path
    recipe: Recipe
    files: tuple[tuple[Path, Targets], ...]
    split: Split[RecordingSource]
    training_samples: int
    validation_samples: int
    history: tuple[EpochLoss, ...]
    best_epoch: int
    training_sha256: str
    half: bool
    parity: Parity
    costs: tuple[Cost, Cost] | None = None


def write_card(result: TrainingResult, results: Mapping[str, str] | None = None) -> None:
    """Write the card beside the model; `results` are figures of held-out races, by their name."""
    sections = (
        _title(result),
        _data(result),
        _remake(result),
        _losses(result),
        _proof(result),
        _races(results or {}),
        LIMITS,
    )
    result.card.write_text("\n\n".join(sections) + "\n", encoding="utf-8")


LIMITS = """## Limits

Trained for one camera model, one lens and one aperture: another aperture or sensor moves the
settings that are right, and the network has no way to know (thesis 5.3). It has seen only the
kinds of scene and the speeds of its recordings, and targets only from settings near the ones its
leader chose. It answers for the next frame; a camera that applies settings later needs training
for that delay. Settings outside the limits above are clamped."""


def _title(result: TrainingResult) -> str:
    recipe, limits = result.recipe, THESIS_LIMITS
    return f"""# {result.model.stem}

A `{recipe.net}` network ({NETWORKS[recipe.net].parameters:,} parameters; thesis 4.2.1): three
224 x 224 RGB pictures and their settings in, exposure time and gain of the next frame out.
Exposure {limits.exposure_us[0]:g} to {limits.exposure_us[1]:g} us, gain {limits.gain_db[0]:g} to \
{limits.gain_db[1]:g} dB. Licence: {LICENCE}."""


def _data(result: TrainingResult) -> str:
    training = "\n".join(f"- {_described(source)}" for source in result.split.training)
    held_back = "\n".join(f"- {_described(source)}" for source in result.split.held_back)
    return f"""## Data

Trained on {result.training_samples:,} samples of:

{training}

Validated on {result.validation_samples:,} samples of:

{held_back or "- nothing: there was only one world, so the last epoch was kept"}

Digest of the target files: `{result.training_sha256}`"""


def _described(source: RecordingSource) -> str:
    split = parse_qs(source.cameras.partition("?")[2]).get("split", [""])[0]
    warning = " **A test world: results on test worlds prove nothing.**" if split == "test" else ""
    return f"`{source.name}`, `{source.cameras}`, sha256 `{source.sha256}`.{warning}"


def _folders(result: TrainingResult) -> Callable[[Path, str], str]:
    """Return where a recording lies: those of one name in two target files have folders apart."""
    names = [one.name for _, targets in result.files for one in targets.recordings]
    shared = {name for name, times in Counter(names).items() if times > 1}
    return lambda path, name: f"{path.stem}/{name}" if name in shared else name


def _remake(result: TrainingResult) -> str:
    folder = _folders(result)
    lines = [
        f"rig collect {_collect_options(source)} --out {shlex.quote(folder(path, source.name))}"
        for path, targets in result.files
        for source in targets.recordings
    ]
    for path, targets in result.files:
        names = " ".join(shlex.quote(folder(path, one.name)) for one in targets.recordings)
        lines.append(
            f"rig targets {names} --metric {targets.metric} --window {targets.window} "
            f"--alpha {targets.alpha:g} --out {shlex.quote(path.name)}"
        )
    recipe = result.recipe
    stored = ("--half " if result.half else "") + ("--int8 " if result.costs else "")
    held_names = dict.fromkeys(source.name for source in result.split.held_back)
    held_back = "".join(f"--hold-back {shlex.quote(name)} " for name in held_names)
    files = " ".join(shlex.quote(path.name) for path, _ in result.files)
    lines.append(
        f"rig train --net {recipe.net} {files} --seed {recipe.seed} --epochs {recipe.epochs} "
        f"--batch-size {recipe.batch_size} --learning-rate {recipe.learning_rate:g} "
        f"--patience {recipe.patience} {stored}{held_back}--out {shlex.quote(result.model.name)}"
    )
    commands = "\n".join(lines)
    return f"""## Made with

```sh
{commands}
```"""


def _collect_options(source: RecordingSource) -> str:
    options = {"cameras": source.cameras, "seed": str(source.seed)}
    if "sweep" in source.options:
        exposures = int(source.options["sweep"])
        options |= {
            "cameras": re.sub(r"&stand=[^&]*|(?<=\?)stand=[^&]*&", "", source.cameras),
            "sweep": str(exposures),
            "gains": source.options["gains"],
            "poses": str(source.triggers // (exposures // 2)),
            "step-m": source.options["step_m"],
        }
    else:
        options |= {
            "frames": str(source.triggers),
            "leader": source.leader,
            "perturb": source.options.get("perturb", "none"),
        }
    return " ".join(f"--{name} {shlex.quote(value)}" for name, value in options.items())


def _losses(result: TrainingResult) -> str:
    rows = "\n".join(
        f"| {epoch + 1}{' (kept)' if epoch == result.best_epoch else ''} | {loss.training:.4f} | "
        f"{'-' if loss.validation is None else f'{loss.validation:.4f}'} |"
        for epoch, loss in enumerate(result.history)
    )
    return f"""## Loss by epoch (thesis eq. 4.15, in 0..1 of the limits)

| epoch | training, with dropout | held back |
|---|---|---|
{rows}"""


def _proof(result: TrainingResult) -> str:
    parity = result.parity
    half = (
        f" Storing the weights in half precision moved answers by at most "
        f"{parity.half_difference:.1e}."
        if result.half
        else ""
    )
    return f"""## Proof of export

Largest difference from the trained network {parity.difference:.1e}, over samples whose answers
range over {parity.spread:.2f} of the limits.{half}{_int8(result)}"""


def _int8(result: TrainingResult) -> str:
    moved = result.parity.int8
    if moved is None or result.costs is None:
        return ""
    files = (result.model, int8_file(result.model))
    rows = "\n".join(
        f"| `{file.name}` | {cost.size_bytes:,} | {cost.forward.median_ms:.2f} | "
        f"{cost.decision.median_ms:.2f} |"
        for file, cost in zip(files, result.costs, strict=True)
    )
    return f"""

## In 8-bit integers

`{files[1].name}` has convolutions of 8-bit integers, scaled on {moved.calibration} training
samples. Over the samples of the proof, answers moved by {moved.mean:.1e} in the mean (of the
setting that moved more) and by {moved.largest:.1e} at most, in shares of the limits.

| file | bytes | forward pass, ms | decision from {BAYER_PX[0]} x {BAYER_PX[1]} Bayer, ms |
|---|---|---|---|
{rows}

Medians, on one core of the machine that trained it."""


def _races(results: Mapping[str, str]) -> str:
    rows = "\n".join(f"- {name}: {value}" for name, value in results.items())
    return f"""## Results on held-out worlds

{rows or "Not raced yet. `rig race network:model=FILE aeag --seeds 1-20` measures it."}"""
