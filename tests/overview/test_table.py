"""Tables of text keep all that is in them, in a terminal and in a notebook."""

from xml.etree import ElementTree

from scso_nlp.overview.table import Table, as_html, as_text

LONG = " ".join(f"muscle_{i}" for i in range(30))
TABLES = (
    Table(title="First", head=("name", "what"), rows=(("a<b>", "[bold]1[/bold]"), ("c", LONG))),
    Table(title="Second", notes=("x & y", LONG)),
)


def test_text_fits_the_terminal_and_nothing_is_lost() -> None:
    text = as_text(TABLES, 60)
    assert max(map(len, text.splitlines())) <= 60
    assert text.split().count("muscle_29") == 2
    # what looks like markup is text
    assert "[bold]1[/bold]" in text
    assert text.splitlines()[0] == "First"


def test_control_characters_of_names_do_not_reach_the_terminal() -> None:
    text = as_text([Table(title="a\x1b[2J", head=("b",), rows=(("\x1b[31mred",),), notes=("\x07",))], 60)
    assert text.isprintable() or not set(text) & {"\x1b", "\x07"}


def test_html_is_well_formed_and_escaped() -> None:
    root = ElementTree.fromstring(f"<div>{as_html(TABLES)}</div>")
    assert [cell.text for cell in root.iter("th")] == ["name", "what"]
    assert [cell.text for cell in root.iter("td")] == ["a<b>", "[bold]1[/bold]", "c", LONG]
    assert [item.text for item in root.iter("strong")] == ["First", "Second"]
    assert [item.text for item in root.iter("div") if item.text] == ["x & y", LONG]
