"""Dead links, and whatever a page would fetch from outside: ``python docs/_site/links.py build/site``."""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Attributes by which a page loads something, rather than offering a link to it.
_LOADING = {"src", "srcset", "poster", "data"}
#: Relations of a ``<link>`` that load nothing.
_IDLE_RELATIONS = {"index", "search", "next", "prev", "canonical", "author", "copyright", "top", "up"}
_OUTSIDE_STYLE = re.compile(r"(?:url\(\s*['\"]?|@import\s+['\"])((?:https?:)?//[^'\")\s]+)")


class Page(HTMLParser):
    """Anchors of a page, and what it links to and loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Sort the attributes of a tag."""
        given = {name: value for name, value in attrs if value}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        loads = tag == "link" and given.get("rel") not in _IDLE_RELATIONS
        for name, value in given.items():
            if name in _LOADING or (name == "href" and loads):
                self.loaded.append(value)
            elif name == "href":
                self.links.append(value)


def faults(folder: Path) -> list[str]:
    """Name every dead link and everything from outside, one sentence each.

    Parameters
    ----------
    folder : Path
        Of a built site.

    Returns
    -------
    list of str
    """
    pages = {path.resolve(): Page(path) for path in sorted(folder.rglob("*.html"))}
    found = [] if pages else [f"{folder}: no page, expected a built site"]
    for path, page in pages.items():
        name = path.relative_to(folder.resolve())
        found += [f"{name}: loads {target} from outside" for target in page.loaded if _is_outside(target)]
        inside = [target for target in (*page.links, *page.loaded) if not _is_outside(target)]
        found += [f"{name}: dead link {target}" for target in inside if not _leads(path, target, pages)]
    for path in sorted(folder.rglob("*.css")):
        targets = _OUTSIDE_STYLE.findall(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(folder)}: loads {target} from outside" for target in targets]
    return found


def _is_outside(target: str) -> bool:
    parts = urlsplit(target)
    return bool(parts.netloc) or parts.scheme not in ("", "file")


def _leads(path: Path, target: str, pages: dict[Path, Page]) -> bool:
    parts = urlsplit(target)
    file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if parts.fragment and file in pages:
        return unquote(parts.fragment) in pages[file].anchors
    return file.is_file()


if __name__ == "__main__":
    wrong = faults(Path(sys.argv[1]))
    print(*wrong, f"{len(wrong)} faults", sep="\n")
    sys.exit(bool(wrong))
