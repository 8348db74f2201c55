"""Where stability rows help and where they do not: ``python -m problems.scorecard [SET ...] [--pages]``.

Solves the sets of PROTOCOL.md, writes ``measured/DATE.json`` and, from the newest of these files,
``docs/scorecard.md`` with its figure, ``docs/scorecard.csv`` and README's paragraph. Sets that are named are
solved again and replace their part of the newest file; with ``--pages`` nothing is solved. Data are fetched
on first use, see :mod:`problems.fetch`.
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
from pathlib import Path
from typing import Any

from problems.benchmarks.measuring import facts
from problems.scorecard.page import write_pages
from problems.scorecard.running import run
from problems.scorecard.sets import SETS
from scso_nlp.exceptions import DataError
from scso_nlp.files import write_whole

ROOT = Path(__file__).parents[2]
MEASURED = Path(__file__).with_name("measured")


def main(arguments: list[str]) -> None:
    """Solve what is asked for, and write it.

    Parameters
    ----------
    arguments : list of str
        As on the command line.
    """
    parser = argparse.ArgumentParser(prog="python -m problems.scorecard", description=__doc__)
    parser.add_argument("sets", nargs="*", choices=[[], *(s.name for s in SETS)], metavar="SET")
    parser.add_argument("--pages", action="store_true", help="only write pages from what was measured")
    parser.add_argument("--measured", type=Path, default=MEASURED, help="folder of result files")
    parser.add_argument("--output", type=Path, default=ROOT, help="folder of README.md and docs")
    asked = parser.parse_args(arguments)
    before = sorted(asked.measured.glob("*.json"))
    found: dict[str, Any] = (
        json.loads(before[-1].read_text(encoding="utf-8")) if before and (asked.sets or asked.pages) else {}
    )
    if not asked.pages:
        today = datetime.date.today().isoformat()
        found = {"date": today, "facts": facts(), "sets": found.get("sets", {})}
        asked.measured.mkdir(parents=True, exist_ok=True)
        for the_set in SETS:
            if asked.sets and the_set.name not in asked.sets:
                continue
            try:
                rows, about = run(the_set, lambda words: sys.stdout.write(f"{words}\n"))
            except DataError as error:
                sys.exit(f"error: {error}")
            found["sets"][the_set.name] = {**about, "commit": found["facts"].get("commit"), "rows": rows}
            with write_whole(asked.measured / f"{today}.json") as temporary:
                temporary.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if not found:
        sys.exit(f"error: nothing measured in {asked.measured}")
    write_pages(found, asked.output)


if __name__ == "__main__":
    main(sys.argv[1:])
