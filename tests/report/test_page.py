"""The page must be whole, self-contained and safe whatever stands in the files it is made from."""

import base64
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure

from scso_nlp.emg import Emg, EmgMap, MotionResult, MuscleGroup, compare
from scso_nlp.exceptions import DataError
from scso_nlp.report.page import render_report, write_report

TIME = np.linspace(0.0, 2.0, 41)
HOSTILE = '<script>alert("x")</script><img src=x onerror=alert(1)>'
#: A picture of one pixel.
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
)


class Page(HTMLParser):
    """Elements with their attributes, and a check that tags are closed in order."""

    VOID = frozenset({"meta", "link", "img", "br"})

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.texts = [], [], []
        self.feed(text)
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def make_result(label="SO", name="lift", report=None, muscles=("erector", "rectus"), solved=None):
    activation = np.column_stack([0.3 + 0.1 * np.sin(3 * TIME), 0 * TIME])
    return MotionResult(
        label=label,
        name=name,
        time=TIME,
        muscles=muscles,
        activation=activation,
        is_solved=np.ones(41, bool) if solved is None else solved,
        report={"summary": "all 41 frames solved", "settings": {"q": 5.0}} if report is None else report,
    )


def with_emg(results):
    emg = Emg(channels=("es",), time=TIME, values=(0.35 + 0.1 * np.sin(3 * TIME))[:, None])
    groups = (MuscleGroup(name="back", muscles=("erector",), channels=("es",)),)
    return compare(results, emg=emg, emg_map=EmgMap(groups=groups))


def test_the_page_stands_alone_and_is_well_formed():
    page = Page(render_report(with_emg([make_result(), make_result("SCSO")])))
    addresses = [
        value
        for _, attributes in page.elements
        for key, value in attributes.items()
        if key in ("src", "href")
    ]
    assert addresses
    assert all(address.startswith(("data:", "#")) for address in addresses)
    assert not page.all("script")
    assert "default-src 'none'" in next(m["content"] for m in page.all("meta") if "http-equiv" in m)
    assert page.all("html")[0]["lang"] == "en"
    assert all(image["alt"] for image in page.all("img"))
    targets = {attributes.get("id") for _, attributes in page.elements}
    assert {link["href"].removeprefix("#") for link in page.all("a")} <= targets


def test_tables_have_headers_for_every_row_and_column():
    page = Page(render_report(with_emg([make_result()])))
    assert all(cell["scope"] in ("row", "col") for cell in page.all("th"))
    text = " ".join(page.texts)
    assert "mean absolute difference" in text
    assert "0.050" in text
    assert "circular block bootstrap" in text
    assert "settings: q" in text


@pytest.mark.parametrize("place", ["label", "name", "muscle", "group", "report", "caption"])
def test_whatever_comes_from_files_is_escaped(place, tmp_path):
    changes = {
        "label": {"label": HOSTILE},
        "name": {"name": HOSTILE},
        "muscle": {"muscles": ("erector", HOSTILE)},
        "report": {"report": {HOSTILE: HOSTILE, "notes": [HOSTILE], "shortfalls": [{"text": HOSTILE}]}},
    }.get(place, {})
    groups = (MuscleGroup(name=HOSTILE, muscles=("erector",)),) if place == "group" else None
    comparison = compare([make_result(**changes)], emg_map=None if groups is None else EmgMap(groups=groups))
    figures = {HOSTILE: Figure()} if place == "caption" else None
    text = render_report(comparison, figures=figures)
    page = Page(text)
    assert not page.all("script")
    assert not [a for _, a in page.elements if any(key.startswith("on") for key in a)]
    assert HOSTILE in "".join(page.texts)
    # figures are images: nothing in them runs, yet nothing of the kind stands in them either
    for image in page.all("img"):
        if image["src"].startswith("data:image/svg"):
            assert b"<script" not in base64.b64decode(image["src"].partition(",")[2])


def test_failed_frames_are_marked_and_counted():
    solved = np.ones(41, bool)
    solved[:4] = False
    page = Page(render_report(compare([make_result(solved=solved)])))
    assert [line for line in page.all("p") if "failed" in line.get("class", "").split()]
    assert any("37 of 41 frames solved" in text for text in page.texts)
    assert any("Tables use the 37 frames" in text for text in page.texts)


def test_the_verdict_stands_at_the_top_and_is_left_out_where_there_is_none():
    said = {"n_frames": 41, "frames_stable": 40, "lines": ["two lines", "of text"]}
    for report, expected in (
        ({"summary": "all is well", "verdict": said}, ("in 40 of 41 frames", False)),
        ({"summary": "all is well", "verdict": "of another program"}, ("", True)),
        ({"summary": "all is well"}, ("", True)),
    ):
        text = render_report(with_emg([make_result(report=report)]))
        page = Page(text)
        assert ("in 40 of 41 frames" in page.texts) == bool(expected[0])
        assert ("all is well" in page.texts) == expected[1], "the summary stands in for a verdict"
        assert "frames_stable" not in text, "the verdict is listed among the facts too"


def test_pictures_are_embedded_and_other_files_refused(tmp_path):
    comparison = compare([make_result()])
    (tmp_path / "walk_stability.png").write_bytes(PNG)
    page = Page(render_report(comparison, pictures=[tmp_path / "walk_stability.png"]))
    assert any("walk stability" in image["alt"] for image in page.all("img"))
    (tmp_path / "fake.png").write_text(HOSTILE)
    with pytest.raises(DataError, match="is not a PNG file"):
        render_report(comparison, pictures=[tmp_path / "fake.png"])
    with pytest.raises(DataError, match="does not exist"):
        render_report(comparison, pictures=[tmp_path / "nothing.png"])


def test_the_same_results_give_the_same_page():
    # ids inside vector figures are drawn at random; all else is equal
    first, second = (re.sub(r'src="[^"]*"', "", render_report(compare([make_result()]))) for _ in range(2))
    assert first == second


def test_the_file_appears_whole_or_not_at_all(tmp_path):
    comparison = compare([make_result()])
    write_report(comparison, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8").endswith("</html>\n")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(DataError, match="cannot be written"):
        write_report(comparison, tmp_path / "nowhere" / "report.html")


def test_muscles_that_have_not_room_in_one_figure_stand_by_joint():
    n = 26
    result = MotionResult(
        label="SO", name="lift", time=TIME, muscles=tuple(f"m{i}" for i in range(n)),
        activation=np.full((41, n), 0.1), is_solved=np.ones(41, bool),
        report={"problem": {"moved_coordinate": {f"m{i}": ("hip_r", "knee_r")[i % 2] for i in range(n)}}},
    )  # fmt: skip
    text = render_report(compare([result]))
    assert text.count("Muscles by the coordinate that they move most") == 2
    assert text.index("<strong>hip_r</strong>") < text.index("<strong>knee_r</strong>")
    assert "m25" in text
