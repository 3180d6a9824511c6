"""From what a person types, `shin:tolerance=mid`, to a controller with every option resolved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, get_type_hints

from rig.core.errors import ControllerError, UsageError
from rig.core.protocols import Controller

CONTROLLERS: Mapping[str, str] = {
    "ae": "AeController",
    "aeag": "AeagController",
    "fixed": "FixedController",
    "geomean": "GeomeanController",
    "kim": "KimController",
    "lu": "LuController",
    "mean": "MeanController",
    "network": "NetworkController",
    "shim": "ShimController",
    "shin": "ShinController",
    "zhang": "ZhangController",
}
"""The class of each controller, in the module of the controller's name; loaded when asked for."""

ALIASES: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "mean-30": ("mean", {"percent": "30"}),
    "mean-50": ("mean", {"percent": "50"}),
    "mean-70": ("mean", {"percent": "70"}),
}
"""Further names: a controller and options that it is given beforehand."""

PLUGINS = "rig.controllers"
"""The group of entry points through which other packages bring controllers."""


@dataclass(frozen=True, slots=True)
class NamedController:
    """A controller as it appears in records.

    `name` is the specification as it was typed, `options` are all options with their values,
    `model` is the network file that the controller runs, None when it runs none.
    """

    name: str
    controller: Controller
    options: Mapping[str, str]
    model: Path | None = None


def make_controller(spec: str, *, seed: int, networks: Mapping[str, Path]) -> NamedController:
    """Return the controller that `spec` names: `name` or `name:key=value,key=value`.

    `networks` maps further names to network files. `seed` is the default of a controller's own
    `seed` option. Raises UsageError for an unknown name or option, a missing option or a bad
    value; ModelError when a network file cannot be used.
    """
    name, _, text = spec.partition(":")
    given = _options(spec, text)
    if name in networks:
        if given:
            raise UsageError(f"{spec}: {name} is a network file and takes no options")
        name, given = "network", {"model": str(networks[name])}
    if name in ALIASES:
        name, before = ALIASES[name]
        given = {**before, **given}
    controller_class = _find(name, networks)
    controller, options = _build(spec, controller_class, given, seed)
    model = options.get("model")
    return NamedController(spec, controller, options, None if model is None else Path(model))


def _find(name: str, networks: Mapping[str, Path]) -> Any:
    """Return the class of a controller of this package or of a plug-in."""
    if name in CONTROLLERS:
        return getattr(import_module(f"rig.controllers.{name}"), CONTROLLERS[name])
    plugins = {point.name: point for point in entry_points(group=PLUGINS)}
    if name not in plugins:
        known = sorted({*CONTROLLERS, *ALIASES, *networks, *plugins})
        raise UsageError(f"unknown controller {name!r}; {_hint(name, known)}")
    point = plugins[name]
    try:
        found = point.load()
    except Exception as problem:  # whatever a stranger's module raises, it is one line here
        raise ControllerError(
            f"controller {name!r}: its plug-in {point.value} cannot be loaded "
            f"({type(problem).__name__}: {problem}); repair or uninstall that package"
        ) from problem
    if not (isinstance(found, type) and is_dataclass(found)):
        raise ControllerError(
            f"controller {name!r}: its plug-in {point.value} is no dataclass; "
            "a controller's fields are its options"
        )
    return found


def _options(spec: str, text: str) -> dict[str, str]:
    """Return the options behind the colon of a specification."""
    options: dict[str, str] = {}
    for item in text.split(",") if text else ():
        key, equals, value = item.partition("=")
        if not (key and equals and value):
            raise UsageError(f"{spec}: {item!r} is no option; write key=value,key=value")
        if key in options:
            raise UsageError(f"{spec}: {key} is given twice; keep one")
        options[key] = value
    return options


def _build(
    spec: str, controller_class: Any, given: Mapping[str, str], seed: int
) -> tuple[Controller, dict[str, str]]:
    """Make the controller; its constructor's fields are its options."""
    types = get_type_hints(controller_class)
    presets = getattr(controller_class, "PRESETS", {})
    own = [field.name for field in fields(controller_class) if field.init]
    known = [*own, *(key for key in presets if key not in own)]
    for key in given:
        if key not in known:
            raise UsageError(f"{spec}: unknown option {key!r}; {_hint(key, known)}")
    given = _with_presets(spec, presets, own, given)
    values = {"seed": seed} if "seed" in known else {}
    values |= {key: _value(spec, key, text, types[key]) for key, text in given.items()}
    for field in fields(controller_class):
        if field.init and field.default is MISSING and field.name not in values:
            raise UsageError(f"{spec}: {field.name} is missing; write {field.name}=VALUE")
    try:
        controller: Controller = controller_class(**values)
    except ValueError as problem:
        raise UsageError(f"{spec}: {problem}") from problem
    return controller, {key: str(getattr(controller, key)) for key in own}


def _with_presets(
    spec: str,
    presets: Mapping[str, Mapping[str, Mapping[str, str]]],
    own: list[str],
    given: Mapping[str, str],
) -> dict[str, str]:
    """Return the options given, and before them those that a preset among them stands for."""
    before: dict[str, str] = {}
    for key, table in presets.items():
        if key not in given:
            continue
        if key not in own and given[key] not in table:
            raise UsageError(
                f"{spec}: unknown {key} {given[key]!r}; {_hint(given[key], sorted(table))}"
            )
        before |= table.get(given[key], {})
    return before | {key: text for key, text in given.items() if key in own}


def _value(spec: str, key: str, text: str, kind: Any) -> Any:
    """Return the value of an option, of the type that the controller declares."""
    try:
        return kind(text)
    except ValueError as problem:
        raise UsageError(f"{spec}: {key} must be a number, got {text!r}") from problem


def _hint(word: str, known: list[str]) -> str:
    close = get_close_matches(word, known, 1)
    suggestion = f"did you mean {close[0]!r}? " if close else ""
    return f"{suggestion}known: {', '.join(known) or 'none'}"
