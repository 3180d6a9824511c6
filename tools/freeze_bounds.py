"""Work out the bounds that come with the rig anew, after a world or the judge has changed.

python tools/freeze_bounds.py 'sim:tunnel?split=test&seed=31&size=640x480'...

Each takes minutes to an hour; counts that are in the user's cache are not counted again.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from rig.experiments.bound import find_bound
from rig.experiments.known_bounds import RECIPE, SHIPPED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cameras", nargs="+")
    bounds = [json.dumps(asdict(find_bound(cameras))) for cameras in parser.parse_args().cameras]
    lines = ",\n    ".join(bounds)
    text = f'{{\n  "recipe": {json.dumps(RECIPE)},\n  "bounds": [\n    {lines}\n  ]\n}}\n'
    SHIPPED.write_text(text, encoding="utf-8")
    print(f"{SHIPPED}: {len(bounds)} bounds")


if __name__ == "__main__":
    main()
