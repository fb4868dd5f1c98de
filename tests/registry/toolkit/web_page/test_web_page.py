from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from registry.toolkit import web_page
from tests.html_page import Page


def test_a_page_has_its_title_and_contents_and_loads_nothing() -> None:
    text = web_page.page("A & <b>", [web_page.note("one"), "", web_page.section("S", "<p>two</p>")])
    page = Page(text)
    assert page.text.count("A & <b>") == 2, "the window's title, and a heading"
    assert page.tags[-5:] == ["body", "h1", "p", "h2", "p"]
    assert page.loads == []
    assert "script" not in page.tags


def test_a_section_without_content_is_skipped() -> None:
    assert web_page.section("Empty", "") == ""
    assert web_page.verbatim("") == ""
    assert web_page.grid([]) == ""
    assert web_page.facts_table({}) == ""


@pytest.mark.parametrize(
    "text",
    [
        web_page.note("<i> & more"),
        web_page.verbatim("<i> & more"),
        web_page.section("<i> & more", "-"),
        web_page.facts_table({"<i> & more": 1}),
        web_page.facts_table({"name": "<i> & more"}),
        web_page.score_table(["<i> & more"], []),
        web_page.score_table(["name"], [[web_page.Cell("<i> & more")]]),
        web_page.score_table(["name"], [], caption="<i> & more"),
        web_page.figure("<i> & more", ""),
        web_page.subsection("<i> & more", "-"),
        web_page.folded("<i> & more", "-"),
        web_page.wipe("", "", ("<i> & more", "b")),
        web_page.choice("<i> & more", {"a": "", "b": ""}),
        web_page.choice("", {"<i> & more": "", "b": ""}),
    ],
)
def test_plain_text_is_escaped(text: str) -> None:
    page = Page(text)
    assert "i" not in page.tags
    assert "<i> & more" in page.text


def test_facts_are_formatted() -> None:
    facts = {"a": {"b": True, "c": None}, "d": 12345, "e": 0.123456, "f": [1, "two"], "g": 12345.6}
    text = web_page.facts_table(facts)
    for cells in ("a.b</th><td>yes", "a.c</th><td>\u2013", "d</th><td>12,345", "e</th><td>0.1235"):
        assert f"<th>{cells}</td>" in text
    assert "<th>f</th><td>1, two</td>" in text
    assert "<th>g</th><td>12,346</td>" in text


def test_a_table_marks_names_and_strong_cells() -> None:
    rows = [[web_page.Cell("a"), web_page.Cell("on"), web_page.Cell("1", strong=True)]]
    text = web_page.score_table(["scene", "part", "psnr"], rows, names=2, caption="mean")
    assert '<th class="name">scene</th><th class="name">part</th><th>psnr</th>' in text
    assert '<td class="name">a</td><td class="name">on</td><td class="strong">1</td>' in text
    assert "<caption>mean</caption>" in text


def test_an_image_is_embedded_with_a_limited_size(tmp_path: Path) -> None:
    red = Image.new("RGBA", (40, 20), (255, 0, 0, 255))
    red.save(tmp_path / "red.png")
    text = "".join(
        [
            web_page.image(tmp_path / "red.png", 'said "so"'),
            web_page.image(red, "small", longest_side=10),
            web_page.image(Image.new("L", (4000, 10)), "wide"),
        ]
    )
    page = Page(text)
    assert [image["alt"] for image in page.images] == ['said "so"', "small", "wide"]
    assert [picture.size for picture in page.pictures()] == [(40, 20), (10, 5), (1560, 4)]
    assert page.pictures()[0].getpixel((20, 10)) == pytest.approx((255, 0, 0), abs=3)
    assert red.size == (40, 20), "the picture that was given is as it was"


def test_a_choice_shows_the_first_part_and_a_single_part_has_no_menu() -> None:
    text = web_page.choice("view", {"a": "<p>one</p>", "b": "<p>two</p>"})
    assert "<div><p>one</p></div><div hidden><p>two</p></div>" in text
    assert Page(text).tags.count("option") == 2
    assert web_page.choice("view", {"a": "<p>one</p>"}) == "<p>one</p>"
    assert web_page.choice("view", {}) == ""


def test_a_color_scale_contains_its_colors() -> None:
    text = web_page.color_scale([(0, 0, 0), (1, 0.5, 0)], ["near", "far"])
    assert "linear-gradient(to right, rgb(0, 0, 0), rgb(255, 128, 0))" in text
    assert "<span>near</span><span>far</span>" in text
