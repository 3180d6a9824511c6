"""The words after `--cameras`, taken apart: `scheme:name?option=value&...`."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, quote

from rig.core.errors import UsageError

SCHEMES = ("sim", "gige", "aravis", "replay")


@dataclass(frozen=True, slots=True)
class Address:
    """An address taken apart: `scheme:name?options`."""

    scheme: str
    name: str
    options: Mapping[str, str]

    def __str__(self) -> str:
        """Return the address with its options in alphabetical order."""
        pairs = (f"{key}={quote(self.options[key], safe='/@:,')}" for key in sorted(self.options))
        query = "&".join(pairs)
        return f"{self.scheme}:{self.name}" + (f"?{query}" if query else "")


def parse_address(text: str) -> Address:
    """Take an address apart; raises UsageError for an unknown scheme or a malformed option."""
    scheme, colon, rest = text.partition(":")
    if not colon:
        example = f"sim:{text or 'tunnel'}"
        raise UsageError(f"--cameras {text!r}: what kind of cameras? Write it as {example}")
    if scheme not in SCHEMES:
        raise unknown("scheme", scheme, SCHEMES, f"--cameras {text}")
    name, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise UsageError(f"{text}: options are written NAME=VALUE&NAME=VALUE") from error
    options = dict(pairs)
    if len(options) < len(pairs):
        twice = next(key for key, _ in pairs if sum(key == other for other, _ in pairs) > 1)
        raise UsageError(f"{text}: option {twice!r} is given twice; keep one")
    return Address(scheme, name, options)


def read_option(address: Address, name: str, word: str, read: Callable[[str], Any]) -> Any:
    """Return an option's value; raises UsageError with what it must be."""
    try:
        return read(word)
    except ValueError as error:
        where = f"{address.scheme}:{address.name}"
        raise UsageError(f"{where}: {name} must be {error}, got {word!r}") from error


def unknown(kind: str, word: str, known: Iterable[str], where: str) -> UsageError:
    """Return the error for a word that is not among the `known`."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(names)}"
    return UsageError(f"{where}: unknown {kind} {word!r}; {hint}")
