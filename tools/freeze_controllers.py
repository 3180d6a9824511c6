"""Write the golden traces of all rivals anew, after their defaults were changed on purpose.

python tools/freeze_controllers.py
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1] / "tests"
TRACES = TESTS / "golden" / "controllers.json"


def main() -> None:
    sys.path.insert(0, str(TESTS))
    from golden_drive import rivals, trace

    old = json.loads(TRACES.read_text(encoding="utf-8")) if TRACES.exists() else {}
    new = {spec: trace(spec) for spec in rivals()}
    lines = [f"  {json.dumps(spec)}: {json.dumps(new[spec])}" for spec in new]
    TRACES.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    changed = [spec for spec in new if old.get(spec) != new[spec]]
    print(f"{TRACES}: {len(new)} rivals, changed: {', '.join(changed) or 'none'}")


if __name__ == "__main__":
    main()
