"""Print how many ORB inliers each exposure and gain gives at some places of a world.

    python tools/settings_map.py tunnel --seed 0 --pairs 12,28,50,75,105

Writes a contact sheet with each place taken with its best settings.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from rig.drivers.scenes.worlds import open_world
from rig.experiments.sweeps import Bench, Counts, SettingsGrid, best_fixed, settings_grid
from rig.vision.bayer import to_bgr


def main() -> None:
    arguments = parse()
    width_px, height_px = (int(side) for side in arguments.size.split("x"))
    scene = open_world(
        arguments.world,
        seed=arguments.seed,
        split=arguments.split,
        width_px=width_px,
        height_px=height_px,
        speed_mps=13.9,
    )
    bench, grid, sheet, maps = Bench(scene), settings_grid(), [], []
    for pair in (int(word) for word in arguments.pairs.split(",")):
        inliers = bench.settings_map(pair, grid)
        maps.append(inliers)
        row, column = np.unravel_index(int(inliers.argmax()), inliers.shape)
        best = (int(row), int(column))
        show(pair, inliers, grid, best)
        picture = to_bgr(bench.picture(pair, grid.settings(best), pair), "bayer_rggb8")
        used = grid.settings(best)
        label = f"pair {pair}: {used.exposure_us:.0f} us {used.gain_db:g} dB, {inliers.max()}"
        cv2.putText(picture, label, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 255), 2)
        sheet.append(picture)
    cell, worst = best_fixed(np.stack(maps))
    print(f"best fixed setting here: {grid.settings(cell)}, worst pair {worst} inliers")
    cv2.imwrite(str(arguments.out), np.vstack(sheet))
    print(arguments.out)


def show(pair: int, inliers: Counts, grid: SettingsGrid, best: tuple[int, int]) -> None:
    place = "on the border" if grid.on_border(best) else "inside"
    print(f"pair {pair}: best {grid.settings(best)} with {inliers.max()} inliers, {place}")
    print("  gain dB " + "".join(f"{gain:7g}" for gain in grid.gains_db))
    for exposure_us, row in zip(grid.exposures_us, inliers, strict=True):
        print(f"{exposure_us:7.0f} us" + "".join(f"{count:7d}" for count in row))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("world")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--split", default="test")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--pairs", default="12,28,50,75,105")
    parser.add_argument("--out", type=Path, default=Path("settings_map.png"))
    return parser.parse_args()


if __name__ == "__main__":
    main()
