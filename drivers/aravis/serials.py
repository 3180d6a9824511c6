"""Serial numbers as printed and as told: some cameras tell the hexadecimal form of the label."""

from __future__ import annotations


def same_serial(label: str, told: str) -> bool:
    """Return whether a label names the camera that tells `told`.

    >>> same_serial("18284899", "01170163"), same_serial("01170163", "18284899")
    (True, True)
    """
    if label.strip().lower() == told.strip().lower():
        return True
    return bool(
        _numbers(label, 10) & _numbers(told, 16) or _numbers(label, 16) & _numbers(told, 10)
    )


def _numbers(text: str, base: int) -> set[int]:
    try:
        return {int(text.strip(), base)}
    except ValueError:
        return set()
